"""Observation: the channels of a measured pose, and their units."""

CHANNELS = ("x", "y", "heading")
"""Names of the columns of a pose."""
UNITS = ("m", "m", "rad")
"""Units of the columns of a pose."""
