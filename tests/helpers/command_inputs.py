"""What tests of the commands are given: the text of a small case, and an effect of the user's own."""

BOARD_TOML = """\
[board]
mass_kg = 7.0
rotor_inertia_kgm2 = 0.0238
wheelset_inertia_kgm2 = 0.001
half_length_m = 0.25
creep_speed_mps = 0.01

[noise]
position_m = 0.0004
heading_rad = 0.0025

[actuator]
kp = 100.0
kd = 10.0

"""
"""The tables of a case that say what its board, noise and actuator are."""

TRAIN_CASE = f"""
title = "the first seconds of level-board"
skid = "free"

{BOARD_TOML}[[runs]]
role = "train"
mocap = "train-forward-1.csv"
object = "board:board"
phi = [[0.916, 4.0, 0.0]]
psi = [[1.57, 4.0, 0.0]]
window_s = [0.0, 4.0]
"""
"""The case of four seconds of one train run of `data/level-board`."""

SHORT_CASE = (
    TRAIN_CASE
    + """
[[runs]]
role = "heldout"
mocap = "heldout-reverse-1.csv"
object = "board:board"
phi = [[0.7, 3.0, 0.0]]
psi = [[1.4, 3.0, 3.14159265]]
window_s = [0.0, 4.0]
"""
)
"""The same with a held-out run."""

WORLD_SPRING = """
import jax.numpy as jnp
import snakejax as sj


class WorldSpring(sj.Force):
    description = "A spring pulls the board to the origin."
    k: sj.Scalar = sj.param("N/m", low=0.0, default=0.0)

    def wrench(self, motion):
        X, Y = motion.into_body(-self.k * motion.x, -self.k * motion.y)
        return X, Y, jnp.zeros_like(X)
"""
"""A file with an effect of the user's own."""
