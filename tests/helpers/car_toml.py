"""The beginning of a case.toml of a car without slip."""

CAR_TOML = """\
skid = "ideal"
[vehicle]
kind = "car"
mass_kg = 1.58
inertia_kgm2 = 0.008
front_m = 0.08
rear_m = 0.09
"""
