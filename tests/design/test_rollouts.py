"""The controller of a designed gait."""

import pytest

from snakejax import Gait, InputError, Sines
from snakejax.design.rollouts import Controller
from snakejax.dynamics.signals import Tracked

SWING = Sines.of([[0.5, 3.0, 0.0]])


def test_both_joints_have_one_controller() -> None:
    assert Controller.of(Gait(SWING, SWING)).kp is None
    tracked = Controller.of(Gait(Tracked(SWING, 100.0, 10.0), Tracked(SWING, 100.0, 10.0)))
    assert (float(tracked.kp), float(tracked.kd)) == (100.0, 10.0)


@pytest.mark.parametrize("rotor", [SWING, Tracked(SWING, 400.0, 10.0)])
def test_two_controllers_are_refused(rotor) -> None:
    with pytest.raises(InputError, match="different controllers"):
        Controller.of(Gait(Tracked(SWING, 100.0, 10.0), rotor))
