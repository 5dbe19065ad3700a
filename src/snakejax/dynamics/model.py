"""Model: vehicle, tyre, constraint and effects combined into one time derivative."""

from collections import OrderedDict
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from snakejax.core.parameter import Scalar

from .constraints import AbstractConstraint
from .contact import AppliedForces, Motion, Wheel, WheelAngles, slip_angle
from .inputs import Gait
from .ports import (
    Delay,
    Effect,
    Force,
    Geometry,
    InputModifier,
    LateralForce,
    Linkage,
    RollingForce,
    Sensor,
    TyreModifier,
    TyreState,
)
from .signals import Joint
from .tyres import AbstractTyre, Pacejka
from .vehicle import AbstractVehicle

E = TypeVar("E", bound=Effect)

State = tuple[tuple[Scalar, ...], tuple[tuple[Scalar, ...], ...]]
"""State of the constraint, and for each `TyreState` effect one memory [rad] for each wheelset."""


class Model(eqx.Module):
    """A vehicle model that can be simulated.

    **Arguments:** `board`: the vehicle; `tyre`: one law for all wheelsets (unused by the ideal board); `constraint`:
    "coupled" (default), "free", "ideal", "printed", or an `AbstractConstraint`; `effects`: by name, in the order in
    which they are applied.

    **Raises:** `ValueError` with the reason if the constraint or an effect does not apply to the board.
    """

    board: AbstractVehicle
    tyre: AbstractTyre
    constraint: AbstractConstraint
    effects: OrderedDict[str, Effect]

    def __init__(
        self,
        board: AbstractVehicle,
        tyre: AbstractTyre,
        constraint: AbstractConstraint | str = "coupled",
        effects: Mapping[str, Effect] | Iterable[tuple[str, Effect]] = (),
    ) -> None:
        if isinstance(constraint, str):
            if constraint not in board.structures:
                known = ", ".join(board.structures)
                raise ValueError(f"Argument `constraint` must be one of {known}, but it is {constraint!r}.")
            constraint = board.structures[constraint]()
        self.board, self.tyre, self.constraint, self.effects = board, tyre, constraint, OrderedDict(effects)

    def __check_init__(self) -> None:
        if why := self.constraint.inapplicable_because(self.board):
            raise ValueError(why)
        for name, effect in self.effects.items():
            if why := effect.inapplicable_because(self):
                raise ValueError(f"Effect `{name}` cannot act here: {why}")

    def add(self, **effects: Effect) -> "Model":
        """This model with further effects, applied after the present ones."""
        return Model(self.board, self.tyre, self.constraint, OrderedDict(self.effects, **effects))

    def without(self, *names: str) -> "Model":
        """This model without the effects `names`."""
        kept = OrderedDict((name, effect) for name, effect in self.effects.items() if name not in names)
        return Model(self.board, self.tyre, self.constraint, kept)

    @property
    def structure(self) -> str:
        """The name of its constraint: "coupled", "free", "ideal", "printed", or that of its class."""
        names = [name for name, kind in self.board.structures.items() if isinstance(self.constraint, kind)]
        return names[0] if names else type(self.constraint).__name__

    def relaxed(self) -> tuple[str, ...]:
        """Name of the structure with independently slipping wheelsets if this one constrains the wheels; else ()."""
        names = [name for name, kind in self.board.structures.items() if type(self.constraint) is kind]
        return tuple(self.board.relaxed[name] for name in names if name in self.board.relaxed)

    def with_payload(self, payload: Any) -> "Model":
        """This model with the `payload` of a run: extra mass [kg] and yaw inertia [kg m^2]."""
        return self.with_traced_payload(payload) if np.any(payload) else self

    def with_traced_payload(self, payload: Any) -> "Model":
        """`with_payload` in a compiled function, where it is not known whether there is any."""
        return eqx.tree_at(lambda model: model.board, self, self.board.with_payload(*payload))

    def effects_of(self, port: type[E]) -> list[E]:
        """The effects of one port, in the order of their `order`, then of the model."""
        effects = [effect for effect in self.effects.values() if isinstance(effect, port)]
        return sorted(effects, key=lambda effect: getattr(effect, "order", 0))

    def effective_vehicle(self) -> AbstractVehicle:
        """The board after all `Geometry` effects."""
        board = self.board
        for effect in self.effects_of(Geometry):
            board = effect.board(board)
        return board

    def commanded(self, gait: Gait) -> Gait:
        """The gait after all `InputModifier` effects."""
        for effect in self.effects_of(InputModifier):
            gait = effect.gait(gait)
        return gait

    def delay(self) -> Scalar:
        """The delay [s] of the reported pose behind the clock of the commands."""
        return sum((effect.delay() for effect in self.effects_of(Delay)), jnp.zeros(()))

    def start(self, pose: tuple[Scalar, Scalar, Scalar]) -> State:
        """The state at rest at (x [m], y [m], heading [rad]); memories are zero."""
        zero = jnp.zeros_like(pose[0])
        lags = tuple(tuple(zero for _ in self.board.wheelsets) for _ in self.effects_of(TyreState))
        return self.constraint.from_rest(*pose), lags

    def initial_state(self, start: tuple[Scalar, ...], t: Scalar, gait: Gait) -> State:
        """The state in motion at time `t` [s]; the first six numbers of `start` are those of
        `AbstractConstraint.in_motion`.

        Further numbers, if any, are the deviations [rad] of the memories from the slip angles, effect by effect and
        wheelset by wheelset.
        """
        board, _, _, steered = self._steered(t, gait)
        body = self.constraint.in_motion(start[:6], board, steered)
        motion = self.motion(t, body, gait)
        slips = [slip_angle(wheel.lateral, wheel.rolling, self.board.creep_speed) for wheel in motion.wheels]
        deviations = list(start[6:]) or [jnp.zeros_like(t)] * self.memories
        count = len(slips)
        return body, tuple(
            tuple(slip + d for slip, d in zip(slips, deviations[count * k : count * (k + 1)], strict=True))
            for k in range(len(self.effects_of(TyreState)))
        )

    @property
    def memories(self) -> int:
        """The number of states added by `TyreState` effects."""
        return len(self.effects_of(TyreState)) * len(self.board.wheelsets)

    def motion(self, t: Scalar, body: tuple[Scalar, ...], gait: Gait) -> Motion:
        """The motion at time `t` [s], as the effects receive it."""
        return self._motion(t, body, gait)[0]

    def _motion(self, t: Scalar, body: tuple[Scalar, ...], gait: Gait) -> tuple[Motion, WheelAngles, Any]:
        board, front, rotor, steered = self._steered(t, gait)
        twist = self.constraint.twist(body, board, steered)
        wheels = tuple(
            Wheel(*parts) for parts in zip(board.wheelsets, *steered, twist.lateral, twist.rolling, strict=True)
        )
        place = (twist.x, twist.y, twist.theta, twist.heading, twist.u, twist.w, twist.r)
        return Motion(t, *place, front, rotor, wheels, board), steered, twist

    def _steered(self, t: Scalar, gait: Gait) -> tuple[AbstractVehicle, Joint, Joint, WheelAngles]:
        """The effective board, the steering and rotor joints, and the wheel angles."""
        board, gait = self.effective_vehicle(), self.commanded(gait)
        front, rotor = gait.phi.at(t), gait.psi.at(t)
        back = None if gait.phi_back is None else gait.phi_back.at(t)
        joints = []
        for wheelset in board.wheelsets:
            if back is not None and wheelset.steering < 0:
                joint = back
            else:
                joint = Joint(*(wheelset.steering * part for part in front))
            for effect in self.effects_of(Linkage):
                joint = effect.steer(joint, wheelset)
            joints.append(joint)
        return board, front, rotor, WheelAngles.of(tuple(joints))

    def rates(self, t: Scalar, state: State, gait: Gait) -> State:
        """Time derivative of `state` at time `t` [s]."""
        body, memories = state
        motion, steered, twist = self._motion(t, body, gait)
        traction, memory_rates = self._traction(motion, memories)
        resistance = tuple(
            sum((effect.resistance(wheel, motion) for effect in self.effects_of(RollingForce)), jnp.zeros_like(t))
            for wheel in motion.wheels
        )
        wrench = (jnp.zeros_like(t),) * 3
        for effect in self.effects_of(Force):
            wrench = tuple(a + b for a, b in zip(wrench, effect.wrench(motion), strict=True))
        loads = AppliedForces(motion.wheels, traction, resistance, wrench, motion.rotor.acceleration)
        return self.constraint.rates(body, motion.board, steered, twist, loads), memory_rates

    def traction(self, motion: Motion, memories: tuple[tuple[Scalar, ...], ...]) -> tuple[Scalar, ...]:
        """The lateral force F_i [N] of each wheelset, positive against its slip."""
        return self._traction(motion, memories)[0]

    def _traction(self, motion: Motion, memories: Any) -> tuple[tuple[Scalar, ...], Any]:
        tyre = self.tyre
        for effect in self.effects_of(TyreModifier):
            tyre = effect.tyre(tyre, motion)
        forces, rates = [], []
        for i, wheel in enumerate(motion.wheels):
            slip = slip_angle(wheel.lateral, wheel.rolling, motion.board.creep_speed)
            wheel_rates = []
            for effect, memory in zip(self.effects_of(TyreState), memories, strict=True):
                wheel_rates.append(effect.rate(memory[i], slip, wheel))
                slip = effect.slip(memory[i], slip)
            force = tyre.force(slip, wheel.lateral)
            for effect in self.effects_of(LateralForce):
                force = effect.lateral(force, wheel, motion)
            forces.append(force)
            rates.append(wheel_rates)
        return tuple(forces), tuple(zip(*rates, strict=True))

    def observe(self, body: tuple[Scalar, ...]) -> tuple[Scalar, Scalar, Scalar]:
        """(x [m], y [m], heading [rad]) as motion capture reports them, after all `Sensor` effects."""
        pose = self.constraint.pose(body)
        for effect in self.effects_of(Sensor):
            pose = effect.observe(*pose)
        return pose


def no_traction() -> Pacejka:
    """A tyre without lateral force, for the ideal board and for slipping without friction."""
    return Pacejka(B=1.0, C=1.0, D=0.0, E=0.0)
