"""A case of two short runs, the first of which carries a payload, written as a user's folder; and an own effect."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from helpers.exports import Motion, tracker
from snakejax import TABLE_II, Board, Gait, Model, Pacejka, Sines, Tracked, simulate

TYRE = dict(B=6.0, C=1.4, D=6.0, E=0.3)
PAYLOAD = (2.0, 0.05)
BOARD = Board(**TABLE_II | {"creep_speed": 0.01})
GAINS = dict(kp=100.0, kd=10.0)
GAITS = {"one": ([[0.7, 4.0, 0.0]], [[1.4, 4.0, 0.3]]), "two": ([[0.6, 3.0, 0.0]], [[1.2, 3.0, 1.0]])}
TOML = """
title = "a board that carries something"
skid = "free"
board = {mass_kg = 7.0, rotor_inertia_kgm2 = 0.0238, wheelset_inertia_kgm2 = 0.001, half_length_m = 0.25, \
creep_speed_mps = 0.01}
noise = {position_m = 0.0004, heading_rad = 0.0025}
actuator = {kp = 100.0, kd = 10.0}
"""
SPRING = '''
import jax.numpy as jnp

import snakejax as sj


class CableSpring(sj.Force):
    """A cable that pulls along x towards `x0`."""

    description = "A cable pulls at the board."
    k: sj.Scalar = sj.param("N/m", low=0.0, default=0.0)
    x0: sj.Scalar = sj.param("m", default=0.0)

    def wrench(self, motion):
        X, Y = motion.into_body(-self.k * (motion.x - self.x0), jnp.zeros_like(motion.x))
        return X, Y, jnp.zeros_like(X)
'''


def laden(tyre=None, payload=PAYLOAD) -> Model:
    """The board under `payload`, as one would measure it."""
    mass, inertia = BOARD.mass + payload[0], BOARD.total_inertia + payload[1]
    board = Board(**TABLE_II | {"creep_speed": 0.01, "mass": mass, "inertia": inertia})
    return Model(board, Pacejka(**TYRE) if tyre is None else tyre, "free")


def written(folder: Path) -> Path:
    """`folder` with the case, `spring.py` and `cost.py` beside it."""
    folder.mkdir()
    times, rng, runs = np.arange(201) / 100, np.random.default_rng(0), ""
    for model, role, (name, (phi, psi)) in zip(
        (laden(), Model(BOARD, Pacejka(**TYRE), "free")), ("train", "heldout"), GAITS.items(), strict=True
    ):
        gait = Gait(*(Tracked(Sines.of(rows), **GAINS) for rows in (phi, psi)))
        pose = np.asarray(simulate(model, gait, jnp.asarray(times)).pose)
        pose = pose + rng.normal(size=pose.shape) * np.array([4e-4, 4e-4, 2.5e-3])
        place = np.column_stack([pose[:, :2], np.zeros(times.size)])
        body = Motion(times, place, Rotation.from_rotvec(np.outer(pose[:, 2], [0, 0, 1])), pose[:, 2])
        (folder / f"{name}.csv").write_text(tracker({"board:board": body}))
        runs += f'[[runs]]\nrole = "{role}"\nmocap = "{name}.csv"\nobject = "board:board"\nphi = {phi}\npsi = {psi}\n'
        runs += f"payload_kg = {PAYLOAD[0]}\npayload_inertia_kgm2 = {PAYLOAD[1]}\n" if name == "one" else ""
    (folder / "case.toml").write_text(TOML + runs)
    (folder.parent / "spring.py").write_text(SPRING)
    (folder.parent / "cost.py").write_text("def left(ran):\n    return -ran.pose[-1, 1]\n")
    return folder
