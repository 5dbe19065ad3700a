"""Model: vehicle, tyre, constraint and effects combined into one time derivative."""

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snakejax.core.parameter import Scalar

from .active_effects import ActiveEffects
from .conditions import ByCondition
from .constraints import AbstractConstraint
from .contact import AppliedForces, Configuration, Motion, Velocities, Wheel, combined_slip, slip_angle
from .inputs import AbstractInputs, Commanded
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
from .tyres import AbstractTyre, Pacejka
from .vehicle import AbstractVehicle

E = TypeVar("E", bound=Effect)
T = TypeVar("T")

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
    active: ActiveEffects | None = eqx.field(init=False)
    """Which effects can change anything, see `active_effects`; None: all."""

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
        self.active = None

    def __repr__(self) -> str:
        """`Model(Board(mass=7 kg, ...), Pacejka(B=8 1/rad, ...), 'free', {'ground_slope': GroundSlope(...)})`."""
        effects = f", {dict(self.effects)}" if self.effects else ""
        return f"Model({self.board}, {self.tyre}, {self.structure!r}{effects})"

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

    def in_run(self, payload: Any, codes: Any) -> "Model":
        """This model as it is in a run with this `payload` (2,) and the labels `codes` (4,), which may be traced."""
        model = self
        for effect in self.effects_of(ByCondition):
            model = effect.applied(model, codes)
        return model.with_traced_payload(payload)

    def effects_of(self, port: type[E]) -> list[E]:
        """The effects of one port, in the order of their `order`, then of the model."""
        effects = [effect for effect in self.effects.values() if isinstance(effect, port)]
        return sorted(effects, key=lambda effect: getattr(effect, "order", 0))

    def with_active(self, active: ActiveEffects) -> "Model":
        """This model, whose compiled rates pass by the effects that are not `active`; these must be neutral."""
        return eqx.tree_at(lambda model: model.active, self, active, is_leaf=lambda leaf: leaf is None)

    def _where_active(self, port: type[Effect], changed: Callable[[], T], unchanged: Callable[[], T]) -> T:
        """`changed()`, with the effects of `port`; `unchanged()` where none of them is active."""
        names = [name for name, effect in self.effects.items() if isinstance(effect, port)]
        if self.active is None or not names:
            return changed()
        return jax.lax.cond(jnp.any(jnp.stack([self.active[name] for name in names])), changed, unchanged)

    def effective_vehicle(self) -> AbstractVehicle:
        """The board after all `Geometry` effects."""
        board = self.board
        for effect in self.effects_of(Geometry):
            board = effect.board(board)
        return board

    def commanded(self, gait: AbstractInputs) -> AbstractInputs:
        """The gait after all `InputModifier` effects."""
        if isinstance(gait, Commanded):
            return gait
        for effect in self.effects_of(InputModifier):
            gait = effect.gait(gait)
        return gait

    def prepared(self, gait: AbstractInputs) -> AbstractInputs:
        """`gait`, with the effects on it made once and for all where one of them is costly (`InputModifier.once`)."""
        costly = any(effect.once for effect in self.effects_of(InputModifier))
        return Commanded(self.commanded(gait)) if costly and not isinstance(gait, Commanded) else gait

    def delay(self) -> Scalar:
        """The delay [s] of the reported pose behind the clock of the commands."""
        return sum((effect.delay() for effect in self.effects_of(Delay)), jnp.zeros(()))

    def start(self, pose: tuple[Scalar, Scalar, Scalar]) -> State:
        """The state at rest at (x [m], y [m], heading [rad]); memories are zero."""
        zero = jnp.zeros_like(pose[0])
        lags = tuple(tuple(zero for _ in self.board.wheelsets) for _ in self.effects_of(TyreState))
        return self.constraint.completed(self.constraint.from_rest(*pose), self.board), lags

    def initial_state(self, start: tuple[Scalar, ...], t: Scalar, gait: AbstractInputs) -> State:
        """The state in motion at time `t` [s]; the first six numbers of `start` are those of
        `AbstractConstraint.in_motion`.

        Further numbers, if any, are the deviations [rad] of the memories from the slip angles, effect by effect and
        wheelset by wheelset.
        """
        board = self.effective_vehicle()
        at_zero = self.constraint.completed(self.constraint.from_rest(*start[:3]), board)
        steered = self._configuration(t, at_zero, gait, board)
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

    def motion(self, t: Scalar, body: tuple[Scalar, ...], gait: AbstractInputs) -> Motion:
        """The motion at time `t` [s], as the effects receive it."""
        return self._motion(t, body, gait)[0]

    def _motion(
        self, t: Scalar, body: tuple[Scalar, ...], gait: AbstractInputs
    ) -> tuple[Motion, Configuration, Velocities]:
        board = self.effective_vehicle()
        steered = self._configuration(t, body, gait, board)
        twist = self.constraint.twist(body, board, steered)
        parts = (board.wheelsets, steered.joints, steered.sines, steered.cosines, twist.lateral, twist.rolling)
        wheels = tuple(Wheel(*of_wheel) for of_wheel in zip(*parts, strict=True))
        place = (twist.x, twist.y, twist.theta, twist.heading, twist.u, twist.w, twist.r)
        motion = Motion(t, *place, steered.inputs, wheels, board)
        return motion._replace(drive=board.drive(motion)), steered, twist

    def _configuration(
        self, t: Scalar, body: tuple[Scalar, ...], gait: AbstractInputs, board: AbstractVehicle
    ) -> Configuration:
        """The joints at time `t` [s] after all effects: inputs, free joints and the angles of the wheels."""
        inputs = self._where_active(InputModifier, lambda: self.commanded(gait).at(t), lambda: gait.at(t))
        inputs = inputs | self.constraint.free_joints(body, board)
        joints = []
        for wheelset in board.wheelsets:
            joint = board.steering(wheelset, inputs)
            for effect in self.effects_of(Linkage):
                joint = effect.steer(joint, wheelset)
            joints.append(joint)
        return Configuration.of(tuple(joints), inputs)

    def rates(self, t: Scalar, state: State, gait: AbstractInputs) -> State:
        """Time derivative of `state` at time `t` [s]."""
        body, memories = state
        motion, steered, twist = self._motion(t, body, gait)
        traction, memory_rates, driven = self._traction(motion, memories)
        resistance = self._resistance(motion)
        for force in (motion.drive, driven):
            if force is not None:
                resistance = tuple(T - D for T, D in zip(resistance, force, strict=True))
        loads = AppliedForces(motion.wheels, traction, resistance, self._wrench(motion))
        return self.constraint.rates(body, motion.board, steered, twist, loads), memory_rates

    def _resistance(self, motion: Motion) -> tuple[Scalar, ...]:
        """The force [N] of all `RollingForce` effects against the rolling of each wheelset."""
        zero = jnp.zeros_like(motion.time)

        def against(wheel: Wheel) -> Scalar:
            return sum((effect.resistance(wheel, motion) for effect in self.effects_of(RollingForce)), zero)

        wheels = motion.wheels
        return self._where_active(RollingForce, lambda: tuple(map(against, wheels)), lambda: (zero,) * len(wheels))

    def _wrench(self, motion: Motion) -> tuple[Scalar, ...]:
        """The wrench of all `Force` effects on the body."""
        zeros = (jnp.zeros_like(motion.time),) * 3

        def total() -> tuple[Scalar, ...]:
            wrench = zeros
            for effect in self.effects_of(Force):
                wrench = tuple(a + b for a, b in zip(wrench, effect.wrench(motion), strict=True))
            return wrench

        return self._where_active(Force, total, lambda: zeros)

    def traction(self, motion: Motion, memories: tuple[tuple[Scalar, ...], ...]) -> tuple[Scalar, ...]:
        """The lateral force F_i [N] of each wheelset, positive against its slip."""
        return self._traction(motion, memories)[0]

    def _traction(self, motion: Motion, memories: Any) -> tuple[tuple[Scalar, ...], Any, tuple[Scalar, ...] | None]:
        """Lateral forces, rates of the memories, and the force along each wheel that its driven rim adds."""
        forces, rates, driven = [], [], []
        for i, wheel in enumerate(motion.wheels):
            wheelset, creep = wheel.wheelset, motion.board.creep_speed
            tyre = self.tyre.of_axle(wheelset.axle).under(motion.board.load(wheelset))
            slip, speed, across, along = slip_angle(wheel.lateral, wheel.rolling, creep), wheel.lateral, None, None
            if (driven_rim := motion.board.rim(wheelset, motion.inputs)) is not None:
                rim = driven_rim.angle
                slip, across, along = combined_slip(wheel.lateral, wheel.rolling - rim, rim, creep)
                speed = jnp.sqrt(wheel.lateral**2 + (wheel.rolling - rim) ** 2 + 1e-12)
            wheel_rates = []
            for effect, memory in zip(self.effects_of(TyreState), memories, strict=True):
                wheel_rates.append(effect.rate(memory[i], slip, wheel))
                slip = effect.slip(memory[i], slip)
            force = self._tyre_force(tyre, slip, speed, motion)
            driven.append(jnp.zeros_like(force) if along is None else -force * along)
            force = force if across is None else force * across
            forces.append(self._lateral(force, wheel, motion))
            rates.append(wheel_rates)
        any_driven = any(wheel.wheelset.drive for wheel in motion.wheels)
        return tuple(forces), tuple(zip(*rates, strict=True)), tuple(driven) if any_driven else None

    def _tyre_force(self, tyre: AbstractTyre, slip: Scalar, speed: Scalar, motion: Motion) -> Scalar:
        """The force [N] of `tyre` after all `TyreModifier` effects."""

        def modified() -> Scalar:
            changed = tyre
            for effect in self.effects_of(TyreModifier):
                changed = effect.tyre(changed, motion)
            return changed.force(slip, speed)

        return self._where_active(TyreModifier, modified, lambda: tyre.force(slip, speed))

    def _lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        """The lateral `force` [N] of a wheelset after all `LateralForce` effects."""

        def changed() -> Scalar:
            last = force
            for effect in self.effects_of(LateralForce):
                last = effect.lateral(last, wheel, motion)
            return last

        return self._where_active(LateralForce, changed, lambda: force)

    def observe(self, body: tuple[Scalar, ...]) -> tuple[Scalar, Scalar, Scalar]:
        """(x [m], y [m], heading [rad]) as motion capture reports them, after all `Sensor` effects."""
        pose = self.constraint.pose(body)
        for effect in self.effects_of(Sensor):
            pose = effect.observe(*pose)
        return pose


def no_traction() -> Pacejka:
    """A tyre without lateral force, for the ideal board and for slipping without friction."""
    return Pacejka(B=1.0, C=1.0, D=0.0, E=0.0)
