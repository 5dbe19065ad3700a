"""The steps common to all commands that compute: set up JAX, read cases, deliver results."""

import argparse
import contextlib
import ctypes
import functools
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from snakejax.core.errors import InputError
from snakejax.core.progress import Progress, ProgressEvent

from .options import targets
from .progress import progress

if TYPE_CHECKING:
    from rich.console import RenderableType

    from snakejax.recording.run import Case
    from snakejax.vehicles.snakeboard.paper_examples import Preset


def cache_folder() -> Path:
    """The folder of compiled programs."""
    if sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "snakejax"


def start_jax() -> None:
    """Set double precision and keep compiled programs on disk, in JAX_COMPILATION_CACHE_DIR if that is set."""
    # Checks that raise call back into Python, and JAX does not cache such programs. With NaN instead, every fit finds
    # the failure in its checks for finite results.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    from snakejax.core.jax_config import prepare_jax

    prepare_jax()
    import jax

    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        with contextlib.suppress(OSError, RuntimeError):
            folder = cache_folder()
            folder.mkdir(parents=True, exist_ok=True)
            jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    _Compiling.listen()


class _Compiling:
    """The seconds spent on compiling, or on reading compiled programs."""

    total = 0.0
    listening = False

    @classmethod
    def listen(cls) -> None:
        if cls.listening:
            return
        from jax import monitoring

        def count(event: str, seconds: float, **_: Any) -> None:
            if event == "/jax/core/compile/backend_compile_duration":
                cls.total += seconds

        monitoring.register_event_duration_secs_listener(count)
        cls.listening = True


class Stopwatch:
    """Seconds since its creation, and the share of compilation in them."""

    def __init__(self) -> None:
        self.start, self.compiled = time.perf_counter(), _Compiling.total

    def seconds(self) -> dict[str, float]:
        from snakejax.present.as_json.provenance import seconds_json

        return seconds_json(time.perf_counter() - self.start, _Compiling.total - self.compiled)


CASES_KEPT = 3
"""Compiled programs are kept in memory for so many cases: the next board of the same size then begins at once, and the
memory of a batch stays what three boards need."""


class Outcome(NamedTuple):
    """The result of a command for one case: JSON, text, a function that writes the files of `--out`, and the name of
    the JSON there (default: that of the command)."""

    json: dict[str, Any]
    text: "RenderableType"
    write: Callable[[Path], None] = lambda folder: None
    name: str = ""


def show(text: "RenderableType") -> None:
    """Print on standard output, as wide as the terminal, or 80 columns without one."""
    from rich.console import Console

    Console(highlight=False, width=None if sys.stdout.isatty() else 80).print(text)


def read_cases(
    paths: Sequence[str], presets: bool, options: argparse.Namespace, to_train: bool = True
) -> Iterator[tuple[str, Any]]:
    """(path, case, preset or `InputError`) for each CASE."""
    from snakejax.recording.case import load_case
    from snakejax.vehicles.snakeboard.paper_examples import PRESETS, preset

    for path in paths:
        try:
            if path in PRESETS and not Path(path).exists():
                if not presets:
                    raise InputError(f"`{path}` is a preset without recordings", "argument CASE", "name a folder")
                yield path, preset(path, options.load, options.camber)
                continue
            if presets and not Path(path).exists() and path.startswith("paper"):
                preset(path)
            if presets and (options.load is not None or options.camber is not None):
                raise InputError(f"{path} has its own board and tyre", "options --load and --camber", "leave them out")
            yield path, load_case(path, to_train=to_train)
        except InputError as error:
            yield path, error


def each_case(
    options: argparse.Namespace,
    work: "Callable[[Case | Preset, Progress], Outcome]",
    *,
    presets: bool = False,
    to_train: bool = True,
    drop_programs: bool = False,
) -> int:
    """Do `work` on each CASE, deliver its result, and return the exit status: 2 for wrong input, 1 for failed numerics.

    A CASE that fails gives one line on standard error; the others are computed all the same. `drop_programs` removes
    the compiled programs from memory after every `CASES_KEPT` of them.
    """
    start_jax()
    cases, status = _readable(options, presets, to_train)
    if not cases:
        return status
    json_paths = _writable_targets(options, list(cases))
    several = len(options.cases) > 1

    def deliver(case: Any, say: Progress) -> None:
        name = case.name
        case, quality, show_findings = _inspected(options, case)

        def say_after_findings(event: ProgressEvent) -> None:
            show_findings()
            say(event)

        outcome = work(case, say_after_findings)
        show_findings()
        outcome.json.update(quality)
        _deliver(options, name, outcome, json_paths, several)

    with progress(options.quiet, len(cases), options.command, options.out is not None) as say:
        for done, (name, case) in enumerate(cases.items()):
            label = f"{name} ({done + 1}/{len(cases)})" if len(cases) > 1 else name
            status = max(status, _status_of(deliver, name, case, functools.partial(say, case=done, label=label)))
            if drop_programs and done + 1 < len(cases) and (done + 1) % CASES_KEPT == 0:
                _drop_programs()
    return status


def _drop_programs() -> None:
    """Remove all compiled programs from memory; those that are needed again are read from the folder on disk."""
    from snakejax.estimation.kept_program import drop_programs

    drop_programs()
    # The C library of GNU/Linux keeps what is freed until it is asked to return it; others have no such function.
    give_back = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if give_back is not None:
        give_back(0)


def _readable(options: argparse.Namespace, presets: bool, to_train: bool) -> tuple[dict[str, Any], int]:
    """The cases and presets by name, and the exit status: 2 where a CASE cannot be read, each with its error line."""
    from .exit_status import DONE, WRONG, complain

    status, cases = DONE, {}
    for path, case in read_cases(options.cases, presets, options, to_train):
        if isinstance(case, InputError):
            status = complain(case, WRONG)
        elif case.name in cases:
            what = f"Two CASEs have the name `{case.name}`"
            raise InputError(what, path, "rename a folder, or run them separately")
        else:
            cases[case.name] = case
    return cases, status


def _writable_targets(options: argparse.Namespace, names: list[str]) -> dict[str, Path | None]:
    """The file of each case's JSON. **Raises:** `InputError` where an output cannot be written."""
    from snakejax.core.files import require_writable

    # With one readable CASE of several, the output is a folder all the same.
    json_paths = targets(options, names if len(options.cases) == 1 else [*names, *([""] * (len(names) == 1))])
    folders = [Path(folder) for folder in (options.out, getattr(options, "csv", None)) if folder]
    for path in [*json_paths.values(), *(folder / "file" for folder in folders)]:
        if path is not None:
            require_writable(path)
    return json_paths


def _status_of(deliver: Callable[[Any, Progress], None], name: str, case: Any, say: Progress) -> int:
    """The exit status of one case; a failure is reported in one line. **Raises:** `InputError` for a wrong option."""
    from snakejax.core.errors import FitError
    from snakejax.simulation.dask_executor import ClusterError

    from .exit_status import DONE, FAILED, WRONG, complain, unexpected

    try:
        deliver(case, say)
    except (FitError, ClusterError) as error:
        return complain(f"{str(error).rstrip('.')} ({name})", FAILED)
    except InputError as error:
        if error.where.startswith("option"):
            raise
        return complain(error, WRONG)
    except (ArithmeticError, RuntimeError) as error:
        return complain(unexpected(error, name), FAILED)
    return DONE


def _inspected(options: argparse.Namespace, case: Any) -> tuple[Any, dict[str, Any], Callable[[], None]]:
    """The repaired `case`, the JSON of its quality, and a function whose first call prints the findings.

    It is called after the options are checked and before anything is fitted.
    **Raises:** `InputError` where a defect must be corrected before any fit.
    """
    from snakejax.recording.run import Case

    if not isinstance(case, Case) or not hasattr(options, "as_recorded"):
        return case, {}, lambda: None
    from snakejax.present.as_json.quality import quality_json
    from snakejax.present.as_text.quality import quality_report
    from snakejax.recording.quality import inspect

    inspection = inspect(case, options.as_recorded)
    unshown = [] if options.quiet or options.json == "-" else [quality_report(inspection)]

    def show_findings() -> None:
        while unshown:
            show(unshown.pop())

    try:
        inspection.require_sound()
    except InputError:
        show_findings()
        raise
    return inspection.case, {"quality": quality_json(inspection)}, show_findings


def _deliver(
    options: argparse.Namespace, name: str, outcome: Outcome, json_paths: Mapping[str, Path | None], several: bool
) -> None:
    from snakejax.core.files import write_whole
    from snakejax.present.as_json.values import as_text

    if name in json_paths and (path := json_paths[name]) is not None:
        write_whole(path, as_text(outcome.json))
    # Results are printed before they are drawn: nothing is lost if a drawing fails.
    if name in json_paths and json_paths[name] is None:
        sys.stdout.write(as_text(outcome.json))
    elif not options.quiet:
        show(outcome.text)
    if options.out is not None:
        folder = Path(options.out) / name if several else Path(options.out)
        write_whole(folder / f"{outcome.name or options.command}.json", as_text(outcome.json))
        outcome.write(folder)
