"""The board: masses, inertias, and where its wheelsets sit."""

import equinox as eqx

from ._units import Parametrised, Scalar, param


class Wheelset(eqx.Module):
    """Where a wheelset sits on the body axis, in half lengths ahead of the middle, and how it follows the steering.

    The snakeboard's front wheelset is `Wheelset(1, 1)`, its back one `Wheelset(-1, -1)`: phi_back = -phi.
    """

    place: float
    steering: float


class Board(Parametrised):
    """A wheeled board with a rotor (paper section II, Table II).

    `inertia` is the total about the vertical, with rotor and wheelsets: I = J + J_r + 2 J_w. Where it is left out the
    paper's assumption I = m L^2 holds. `offset` is how far the centre of mass lies ahead of the middle.
    """

    mass: Scalar = param("kg", positive=True)
    rotor_inertia: Scalar = param("kg m^2", low=0.0)
    wheelset_inertia: Scalar = param("kg m^2", low=0.0)
    half_length: Scalar = param("m", positive=True)
    creep_speed: Scalar = param("m/s", positive=True, default=1e-3)
    inertia: Scalar | None = param("kg m^2", positive=True, default=None)
    offset: Scalar = param("m", default=0.0)
    wheelsets: tuple[Wheelset, ...] = (Wheelset(1.0, 1.0), Wheelset(-1.0, -1.0))

    @property
    def total_inertia(self) -> Scalar:
        """Yaw inertia I [kg m^2]: as measured, or m L^2."""
        return self.mass * self.half_length**2 if self.inertia is None else self.inertia

    def arm(self, wheelset: Wheelset) -> Scalar:
        """Distance [m] of a wheelset ahead of the centre of mass."""
        return wheelset.place * self.half_length - self.offset

    def loaded(self, mass: Scalar, inertia: Scalar) -> "Board":
        """The board under a payload of `mass` [kg] and yaw inertia `inertia` [kg m^2] at its centre of mass."""
        return eqx.tree_at(
            lambda b: (b.mass, b.inertia),
            self,
            (self.mass + mass, self.total_inertia + inertia),
            is_leaf=lambda leaf: leaf is None,
        )


TABLE_II = dict(mass=7.0, rotor_inertia=0.0238, wheelset_inertia=0.001, half_length=0.25)
