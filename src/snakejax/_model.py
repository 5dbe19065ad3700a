"""A model: a board, its tyre, its skid structure and an ordered set of effects, as one time derivative."""

from collections import OrderedDict
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ._board import Board
from ._effect import Clock, Command, Effect, Floor, Force, Grip, Layout, Linkage, Memory, Motion, Rolling, Sensor, Wheel
from ._gait import Gait, Joint
from ._math import slip_angle
from ._skid import SKIDS, AbstractSkid, Loads, Steered
from ._tyre import AbstractTyre, Pacejka
from ._units import Scalar

E = TypeVar("E", bound=Effect)

State = tuple[tuple[Scalar, ...], tuple[tuple[Scalar, ...], ...]]
"""The state of the skid structure, and for each effect with memory one state a wheelset."""


def _as_skid(skid: Any) -> AbstractSkid:
    if isinstance(skid, str):
        if skid not in SKIDS:
            raise ValueError(f"Argument `skid` must be one of {', '.join(SKIDS)}, but it is {skid!r}.")
        return SKIDS[skid]()
    return skid


class Model(eqx.Module):
    """A snakeboard that can be simulated.

    **Arguments:** `board`; `tyre`, one law for all wheelsets (the ideal board does without); `skid`: "coupled" (the
    default), "free", "ideal", "printed", or a structure of your own; `effects`, by name, in the order they act.

    **Raises:** `ValueError` where the structure cannot carry the board or an effect cannot act, with the reason.
    """

    board: Board
    tyre: AbstractTyre
    skid: AbstractSkid = eqx.field(converter=_as_skid, default="coupled")
    effects: OrderedDict[str, Effect] = eqx.field(converter=OrderedDict, default=())

    def __check_init__(self) -> None:
        if why := self.skid.refusal(self.board):
            raise ValueError(why)
        for name, effect in self.effects.items():
            if why := effect.refusal(self):
                raise ValueError(f"Effect `{name}` cannot act here: {why}")

    def add(self, **effects: Effect) -> "Model":
        """This model with further effects, which act after those it has."""
        return Model(self.board, self.tyre, self.skid, OrderedDict(self.effects, **effects))

    def without(self, *names: str) -> "Model":
        """This model without the effects named."""
        kept = OrderedDict((name, effect) for name, effect in self.effects.items() if name not in names)
        return Model(self.board, self.tyre, self.skid, kept)

    def carrying(self, payload: Any) -> "Model":
        """This model under the `payload` of a run, extra mass [kg] and yaw inertia [kg m^2]; itself under none."""
        if not np.any(payload):
            return self
        return eqx.tree_at(lambda model: model.board, self, self.board.loaded(*payload))

    def plugged(self, port: type[E]) -> list[E]:
        """The effects of one port, in order."""
        found = [effect for effect in self.effects.values() if isinstance(effect, port)]
        return sorted(found, key=lambda effect: getattr(effect, "stage", 0))

    def laid_out(self) -> Board:
        """The board as the layout effects leave it."""
        board = self.board
        for effect in self.plugged(Layout):
            board = effect.board(board)
        return board

    def commanded(self, gait: Gait) -> Gait:
        """The gait as the command effects leave it."""
        for effect in self.plugged(Command):
            gait = effect.gait(gait)
        return gait

    def delay(self) -> Scalar:
        """How far the reported pose lags behind the command clock [s]."""
        return sum((effect.delay() for effect in self.plugged(Clock)), jnp.zeros(()))

    def start(self, pose: tuple[Scalar, Scalar, Scalar]) -> State:
        """The state of this board at rest at (x [m], y [m], heading [rad])."""
        zero = jnp.zeros_like(pose[0])
        lags = tuple(tuple(zero for _ in self.board.wheelsets) for _ in self.plugged(Memory))
        return self.skid.at_rest(*pose), lags

    def start_moving(self, start: tuple[Scalar, ...], t: Scalar, gait: Gait) -> State:
        """The state of this board under way at time `t`; the first six of `start` as in `AbstractSkid.under_way`.

        The others, if any, are how far [rad] each effect with memory is from the slip angle, wheelset by wheelset.
        """
        board, _, _, steered = self._steered(t, gait)
        body = self.skid.under_way(start[:6], board, steered)
        motion = self.motion(t, body, gait)
        slips = [slip_angle(wheel.lateral, wheel.rolling, self.board.creep_speed) for wheel in motion.wheels]
        behind = list(start[6:]) or [jnp.zeros_like(t)] * self.memories
        count = len(slips)
        return body, tuple(
            tuple(slip + d for slip, d in zip(slips, behind[count * k : count * (k + 1)], strict=True))
            for k in range(len(self.plugged(Memory)))
        )

    @property
    def memories(self) -> int:
        """How many states the effects with memory add."""
        return len(self.plugged(Memory)) * len(self.board.wheelsets)

    def motion(self, t: Scalar, body: tuple[Scalar, ...], gait: Gait) -> Motion:
        """Everything the effects may ask about one instant."""
        return self._motion(t, body, gait)[0]

    def _motion(self, t: Scalar, body: tuple[Scalar, ...], gait: Gait) -> tuple[Motion, Steered, Any]:
        board, front, rotor, steered = self._steered(t, gait)
        twist = self.skid.twist(body, board, steered)
        wheels = tuple(
            Wheel(*parts) for parts in zip(board.wheelsets, *steered, twist.lateral, twist.rolling, strict=True)
        )
        place = (twist.x, twist.y, twist.theta, twist.heading, twist.u, twist.w, twist.r)
        return Motion(t, *place, front, rotor, wheels, board), steered, twist

    def _steered(self, t: Scalar, gait: Gait) -> tuple[Board, Joint, Joint, Steered]:
        """The board as laid out, the steering and rotor joints, and the wheel angles."""
        board, gait = self.laid_out(), self.commanded(gait)
        front, rotor = gait.phi.at(t), gait.psi.at(t)
        back = None if gait.phi_back is None else gait.phi_back.at(t)
        joints = []
        for wheelset in board.wheelsets:
            if back is not None and wheelset.steering < 0:
                joint = back
            else:
                joint = Joint(*(wheelset.steering * part for part in front))
            for effect in self.plugged(Linkage):
                joint = effect.steer(joint, wheelset)
            joints.append(joint)
        return board, front, rotor, Steered.of(tuple(joints))

    def rates(self, t: Scalar, state: State, gait: Gait) -> State:
        """Time derivative of `state` at time `t` [s]."""
        body, memories = state
        motion, steered, twist = self._motion(t, body, gait)
        traction, memory_rates = self._traction(motion, memories)
        resistance = tuple(
            sum((effect.resistance(wheel, motion) for effect in self.plugged(Rolling)), jnp.zeros_like(t))
            for wheel in motion.wheels
        )
        wrench = (jnp.zeros_like(t),) * 3
        for effect in self.plugged(Force):
            wrench = tuple(a + b for a, b in zip(wrench, effect.wrench(motion), strict=True))
        loads = Loads(motion.wheels, traction, resistance, wrench, motion.rotor.acceleration)
        return self.skid.rates(body, motion.board, steered, twist, loads), memory_rates

    def traction(self, motion: Motion, memories: tuple[tuple[Scalar, ...], ...]) -> tuple[Scalar, ...]:
        """The lateral force F_i [N] of each wheelset, counted against its slip."""
        return self._traction(motion, memories)[0]

    def _traction(self, motion: Motion, memories: Any) -> tuple[tuple[Scalar, ...], Any]:
        tyre = self.tyre
        for effect in self.plugged(Floor):
            tyre = effect.tyre(tyre, motion)
        forces, rates = [], []
        for i, wheel in enumerate(motion.wheels):
            slip = slip_angle(wheel.lateral, wheel.rolling, motion.board.creep_speed)
            wheel_rates = []
            for effect, memory in zip(self.plugged(Memory), memories, strict=True):
                wheel_rates.append(effect.rate(memory[i], slip, wheel))
                slip = effect.slip(memory[i], slip)
            force = tyre.force(slip, wheel.lateral)
            for effect in self.plugged(Grip):
                force = effect.lateral(force, wheel, motion)
            forces.append(force)
            rates.append(wheel_rates)
        return tuple(forces), tuple(zip(*rates, strict=True))

    def observe(self, body: tuple[Scalar, ...]) -> tuple[Scalar, Scalar, Scalar]:
        """(x, y, heading) as motion capture reports them."""
        pose = self.skid.pose(body)
        for effect in self.plugged(Sensor):
            pose = effect.observe(*pose)
        return pose


def no_traction() -> Pacejka:
    """The tyre of a board that has none to give: every skid structure without forces, and the ideal board."""
    return Pacejka(B=1.0, C=1.0, D=0.0, E=0.0)
