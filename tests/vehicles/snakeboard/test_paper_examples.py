"""Check values of the paper's gaits (Salman et al., CDC 2016); P1 is its rotate result."""

import numpy as np
import pytest
from helpers.reference_board import PACEJKA, last_pose, table_2
from oracles import full_equations as full

from snakejax.dynamics.model import no_traction
from snakejax.dynamics.tyres import Rayleigh


@pytest.mark.slow
@pytest.mark.parametrize(
    ("constraint", "tyre", "heading"),
    [
        ("coupled", PACEJKA, 0.919),
        ("coupled", Rayleigh(9.0), 1.003),
        ("free", PACEJKA, 2.076),
        ("free", Rayleigh(9.0), 1.294),
        ("ideal", no_traction(), 1.684),
    ],
    ids=["coupled Pacejka", "coupled Rayleigh", "free Pacejka", "free Rayleigh", "ideal"],
)
def test_rotate_turns_as_far_as_the_paper_and_the_reference_say(constraint, tyre, heading):
    """P1: Table II and the rotate gait for 14 s; the paper reads about 0.95 rad for both of its models."""
    assert last_pose(table_2(tyre, constraint, creep=1e-4), full.ROTATE, 14.0)[2] == pytest.approx(heading, abs=0.002)


@pytest.mark.parametrize(
    ("gait", "duration", "pose"),
    [
        (full.ROTATE, 14.0, (0.013834, 0.004189, 0.98778)),
        (full.FORWARD, 7.7, (0.031363, 0.004788, 0.03946)),
    ],
    ids=["rotate", "forward"],
)
def test_crab_angle_check_values(gait, duration, pose):
    """Rayleigh with k_s = 9 and both wheelsets turned by a further 0.1 rad."""
    model = table_2(Rayleigh(9.0), crab=(0.1, 0.1))
    np.testing.assert_allclose(last_pose(model, gait, duration), pose, atol=6e-6)
