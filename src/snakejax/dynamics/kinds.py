"""Names of the model kinds and constraint structures; without JAX, so that help texts need not wait for it."""

TYRE_LAWS = ("pacejka", "rayleigh")
"""Laws of the lateral force that a fit can start from."""
MODEL_KINDS = (*TYRE_LAWS, "ideal")
"""A tyre law, or the ideal board, whose wheels do not slip."""
CASE_STRUCTURES = ("free", "coupled")
"""Constraint structures that a case, or the base of a diagnosis, may have."""
TYRE_STRUCTURES = (*CASE_STRUCTURES, "printed")
"""Constraint structures with a tyre law."""
STRUCTURES = (*TYRE_STRUCTURES, "ideal")
"""All constraint structures of the snakeboard."""
LABELS = ("group", "floor", "day", "session")
"""What the runs of a case can be labelled with."""
