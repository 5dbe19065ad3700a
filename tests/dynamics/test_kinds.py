"""The names of kinds and structures, which help texts list without JAX, against the classes that they name."""

import subprocess
import sys

from snakejax import TABLE_II, Board
from snakejax.dynamics.kinds import CASE_STRUCTURES, MODEL_KINDS, STRUCTURES, TYRE_STRUCTURES
from snakejax.estimation.initial_model import starting_tyre


def test_the_structures_are_those_of_the_snakeboard() -> None:
    assert sorted(STRUCTURES) == sorted(Board.structures)
    assert {name for name in STRUCTURES if Board.structures[name].slips} == set(TYRE_STRUCTURES)
    assert {*Board.relaxed, *Board.relaxed.values()} == set(CASE_STRUCTURES)


def test_every_kind_of_model_has_a_tyre_to_start_from() -> None:
    board = Board(**TABLE_II)
    assert (
        len({type(starting_tyre(kind, board)).__name__ for kind in MODEL_KINDS}) == 2
    )  # Ideal: Pacejka without force.


def test_the_list_does_not_wait_for_jax() -> None:
    script = "import sys, snakejax.dynamics.kinds; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True)
