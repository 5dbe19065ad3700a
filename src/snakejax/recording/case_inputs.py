"""The inputs of the runs of a case: sines or logs, and the actuators behind them."""

import dataclasses
import difflib
import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from snakejax.core.parameter import Domain
from snakejax.core.toml_table import Table
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.sampled_signals import HISTORY, Actuator, Held, samples_between
from snakejax.dynamics.signals import AbstractSignal, Logged, Sines, Tracked
from snakejax.dynamics.vehicle import AbstractVehicle
from snakejax.dynamics.vehicle_input import FOLLOWS_OPPOSITE, Input

from .quality import smoothed
from .readers import InputLog, read_input_log
from .run import LogClock

KINDS = ("commanded", "measured")
GAINS = ("kp", "kd")
LOG_KEYS = ("file", "kind", "offset_s", "drift", "hold")
ESTIMATE = "estimate"
LOG_EXAMPLE = 'joint_log = {file = "joints.csv", kind = "commanded"}'

Signal = Sines | Logged | Held


class RawInputs(NamedTuple):
    """The signals of one run before any actuator, by name; `exact` where they were measured."""

    signals: dict[str, Signal]
    exact: bool


class Actuators(NamedTuple):
    """The gains of the controller of all inputs, and the actuator or gains of single ones by name."""

    gains: dict[str, float] | None
    by_input: dict[str, Actuator | dict[str, float]]


def read_actuators(table: Table, vehicle: AbstractVehicle) -> Actuators:
    """[actuator] and its tables [actuator.NAME]. **Raises:** `InputError` for anything that cannot be used."""
    if "actuator" not in table.values:
        return Actuators(None, {})
    actuator = table.table("actuator", "[actuator] with kp and kd")
    names = [given.name for given in vehicle.inputs]
    actuator.require_known([*GAINS, *names])
    gains = None
    if any(key in actuator.values for key in GAINS) or not actuator.values:
        gains = {key: actuator.number(key, domain_of(Tracked, key)) for key in GAINS}
    by_input = {}
    for name in names:
        if name in actuator.values:
            by_input[name] = _actuator(actuator.table(name, f"[actuator.{name}] with lag_s, or kp and kd"))
    return Actuators(gains, by_input)


def _actuator(table: Table) -> Actuator | dict[str, float]:
    keys = {"gain": "gain", "offset": "offset", "dead_band": "dead_band", "saturation": "saturation", "lag_s": "lag"}
    table.require_known([*GAINS, *keys])
    if any(key in table.values for key in GAINS):
        if beside := next((key for key in keys if key in table.values), None):
            raise table.error(beside, "stands beside kp and kd", "keep the gains or the other keys")
        return {key: table.number(key, domain_of(Tracked, key)) for key in GAINS}
    return Actuator(
        **{field: table.number(key, domain_of(Actuator, field)) for key, field in keys.items() if key in table.values}
    )


def read_inputs(row: Table, folder: Path, vehicle: AbstractVehicle) -> RawInputs:
    """The signals of one run. **Raises:** `InputError` for a log or sines that cannot be used."""
    if "joint_log" in row.values:
        return _logged(row, folder, vehicle)
    given = [one for one in vehicle.inputs if one.follows is None or one.name in row.values]
    rows = {one.name: row.numbers(one.name, 3, f"{one.name} = [[amplitude, frequency, phase], ...]") for one in given}
    return RawInputs({name: Sines.of(terms) for name, terms in rows.items()}, exact=False)


def _logged(row: Table, folder: Path, vehicle: AbstractVehicle) -> RawInputs:
    path, kind = log_file(row, folder)
    log = read_input_log(path, vehicle.inputs)
    times = log_clock(row).camera_times(log.times)
    table = row.table("joint_log", LOG_EXAMPLE)
    hold = table.values.get("hold", False)
    if not isinstance(hold, bool):
        raise table.error("hold", "must be true or false", "write hold = true for commands that last until the next")
    # A joint is accelerated from rest; a command may jump.
    measured = kind == "measured"
    if hold:
        kept = _kept(row, times)
        return RawInputs({name: Held.of(times[kept], v[kept]) for name, v in log.values.items()}, exact=measured)
    signals = {name: Logged.of(times, *smoothed(times, v, starts=measured)) for name, v in log.values.items()}
    return RawInputs(signals, exact=measured)


def _kept(row: Table, times: Float[np.ndarray, " n"]) -> slice:
    """The samples of a held log that matter in the window of a run."""
    if "window_s" not in row.values:
        return slice(None)
    start, last = row.vector("window_s", 2, "window_s = [first second, last second]")
    # A run from rest is simulated from time 0, wherever its window begins.
    begins = start if row.values.get("start") == "moving" else min(start, 0.0)
    return samples_between(times, begins - HISTORY, last)


def input_keys(vehicle: AbstractVehicle) -> tuple[str, ...]:
    """The keys of a run that hold sines."""
    return tuple(given.name for given in vehicle.inputs)


def log_clock(row: Table) -> LogClock:
    """What `case.toml` says of the log's clock; what it says "estimate" for is 0 and free."""
    log = row.table("joint_log", LOG_EXAMPLE)
    free = tuple(key for key in ("offset_s", "drift") if log.values.get(key) == ESTIMATE)
    domains = {
        "offset_s": Domain("s", -math.inf, math.inf, False, False),
        "drift": Domain("-", -0.1, 0.1, False, False),
    }
    known = {key: log.number(key, d) for key, d in domains.items() if key in log.values and key not in free}
    names = tuple(key.removesuffix("_s") for key in free)
    if free and log.values.get("hold"):
        what = "cannot be estimated for held commands"
        raise log.error(f"{free[0]}", what, "write it as a number; the effect clock_offset finds a common one")
    return LogClock(known.get("offset_s", 0.0), known.get("drift", 0.0), free=names)


def built_inputs(raw: Sequence[RawInputs], actuators: Actuators, vehicle: AbstractVehicle) -> list[AbstractInputs]:
    """The inputs of all runs, alike in structure so that runs batch: as many sines, and a follower all or none."""
    for one in vehicle.inputs:
        if one.follows is not None and any(one.name in r.signals for r in raw):
            raw = [r._replace(signals=_with_follower(r.signals, one)) for r in raw]
    sines = [s.amplitude.shape[0] for r in raw for s in r.signals.values() if isinstance(s, Sines)]

    def acted(name: str, signal: Signal, exact: bool) -> AbstractSignal:
        if isinstance(signal, Sines):
            signal = signal.padded(max(sines))
        actuator = actuators.by_input.get(name, actuators.gains)
        if exact or actuator is None:
            return signal
        return actuator.acted(signal) if isinstance(actuator, Actuator) else Tracked(signal, **actuator)

    return [
        vehicle.inputs_of(OrderedDict((name, acted(name, s, r.exact)) for name, s in r.signals.items())) for r in raw
    ]


def require_trackable(raw: Sequence[RawInputs], rows: Sequence[Table], actuators: Actuators) -> None:
    """**Raises:** `InputError` where held commands shall be tracked by gains: their steps have no rate."""
    for signals, row in zip(raw, rows, strict=True):
        for name, signal in signals.signals.items():
            tracked = isinstance(actuators.by_input.get(name, actuators.gains), dict)
            if isinstance(signal, Held) and tracked and not signals.exact:
                what = f"holds {name} between samples, but kp and kd track commands without jumps"
                raise row.error("joint_log", what, f"write [actuator.{name}] with lag_s in place of kp and kd")


def _with_follower(signals: Mapping[str, Signal], follower: Input) -> dict[str, Signal]:
    if follower.name in signals:
        return dict(signals)
    assert follower.follows is not None
    leader = signals[follower.follows.removeprefix(FOLLOWS_OPPOSITE)]
    opposite = follower.follows.startswith(FOLLOWS_OPPOSITE)
    return {**signals, follower.name: _opposite(leader) if opposite else leader}


def _opposite(signal: Signal) -> Signal:
    if isinstance(signal, Logged):
        return dataclasses.replace(signal, coefficients=-signal.coefficients)
    if isinstance(signal, Held):
        return Held(signal.knots, -signal.values)
    return Sines(-signal.amplitude, signal.frequency, signal.phase)


def log_file(row: Table, folder: Path) -> tuple[Path, str]:
    """The file of a run's log, and its kind. **Raises:** `InputError` where there is none."""
    log = row.table("joint_log", LOG_EXAMPLE)
    log.require_known(LOG_KEYS)
    return named_file(log, "file", folder), log.choice("kind", KINDS)


def log_of(row: Table, folder: Path, vehicle: AbstractVehicle) -> InputLog:
    """The log of a run. **Raises:** `InputError` where it cannot be read."""
    return read_input_log(log_file(row, folder)[0], vehicle.inputs)


def named_file(table: Table, key: str, folder: Path) -> Path:
    """The file that `key` names. **Raises:** `InputError` where there is none, with the most similar name."""
    name = table.text(key, f'{key} = "file.csv"')
    path = folder / name
    if not path.exists():
        files = sorted(p.relative_to(folder).as_posix() for p in folder.iterdir() if p.name != "case.toml")
        close = difflib.get_close_matches(name, files, 1)
        remedy = f'write "{close[0]}" or add the file' if close else "add the file or correct its name"
        raise table.error(key, f'names "{name}", but there is no such file', remedy)
    return path


def domain_of(cls: type, field: str) -> Domain:
    """The domain of a parameter of a class."""
    return next(f.metadata["domain"] for f in dataclasses.fields(cls) if f.name == field)
