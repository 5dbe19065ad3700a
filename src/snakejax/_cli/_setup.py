"""What every command that computes does alike: JAX, cases, results."""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from .._errors import InputError
from ._options import targets
from ._progress import Say, progress

if TYPE_CHECKING:
    from rich.console import RenderableType

    from .._presets import Preset
    from .._recording import Case


def cache_folder() -> Path:
    """Where compiled programs are kept between runs."""
    if sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "snakejax"


def start_jax() -> None:
    """Double precision, and compiled programs kept on disk; JAX_COMPILATION_CACHE_DIR says where, if it is set."""
    # Checks that raise call back into Python, and a program that does is not kept on disk. As NaN they end in the
    # checks for finite results that every fit makes.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    from .._prepare import prepare_jax

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
    """The seconds that XLA has compiled, or read compiled programs."""

    total = 0.0
    listening = False

    @classmethod
    def listen(cls) -> None:
        if cls.listening:
            return
        from jax import monitoring

        def heard(event: str, seconds: float, **_: Any) -> None:
            if event == "/jax/core/compile/backend_compile_duration":
                cls.total += seconds

        monitoring.register_event_duration_secs_listener(heard)
        cls.listening = True


class Clock:
    """Seconds since it was made, and how many of them were compilation."""

    def __init__(self) -> None:
        self.start, self.compiled = time.perf_counter(), _Compiling.total

    def seconds(self) -> dict[str, float]:
        from .._provenance import seconds_json

        return seconds_json(time.perf_counter() - self.start, _Compiling.total - self.compiled)


class Outcome(NamedTuple):
    """What a command found on one case: its JSON, its text, and whatever else it writes into `--out`."""

    json: dict[str, Any]
    text: "RenderableType"
    write: Callable[[Path], None] = lambda folder: None


def show(text: "RenderableType") -> None:
    """Print on standard output: as wide as the terminal, or 80 columns elsewhere."""
    from rich.console import Console

    Console(highlight=False, width=None if sys.stdout.isatty() else 80).print(text)


def read_cases(paths: Sequence[str], presets: bool, options: argparse.Namespace) -> Iterator[tuple[str, Any]]:
    """(path, case, preset or `InputError`) for each CASE."""
    from .._case import load_case
    from .._presets import PRESETS, preset

    for path in paths:
        try:
            if path in PRESETS and not Path(path).exists():
                if not presets:
                    raise InputError(f"`{path}` is a preset and holds no recording", "argument CASE", "name a folder")
                yield path, preset(path, options.load, options.camber)
                continue
            if presets and not Path(path).exists() and path.startswith("paper"):
                preset(path)
            if presets and (options.load is not None or options.camber is not None):
                raise InputError(
                    f"{path} has its own board and tyre", "options --load and --camber", "leave them out here"
                )
            yield path, load_case(path)
        except InputError as error:
            yield path, error


def each_case(
    options: argparse.Namespace, work: "Callable[[Case | Preset, Say], Outcome]", *, presets: bool = False
) -> int:
    """Do `work` on each CASE and deliver it; the exit status: 2 where an input was wrong, 1 where numerics failed.

    A CASE that fails is complained of in one line, and the others are done all the same.
    """
    from ._main import DONE, FAILED, WRONG, complain, unexpected

    start_jax()
    from .._cluster import ClusterError
    from .._errors import FitError
    from .._files import require_writable

    status, cases = DONE, {}
    for path, case in read_cases(options.cases, presets, options):
        if isinstance(case, InputError):
            status = complain(case, WRONG)
        elif case.name in cases:
            what = f"Two CASEs are called `{case.name}`, and their results would be too"
            raise InputError(what, path, "rename a folder, or run them apart")
        else:
            cases[case.name] = case
    if not cases:
        return status
    # With one good CASE of several, a folder was asked for all the same.
    wanted = targets(options, [*cases] if len(options.cases) == 1 else [*cases, *([""] * (len(cases) == 1))])
    for path in [*wanted.values(), *(Path(d) / "file" for d in (options.out, getattr(options, "csv", None)) if d)]:
        if path is not None:
            require_writable(path)
    with progress(options.quiet, len(cases), options.command, options.out is not None) as say:
        for count, (name, case) in enumerate(cases.items(), 1):
            label = f"{name} ({count}/{len(cases)})" if len(cases) > 1 else name
            try:

                def told(
                    message: str,
                    done: int | None = None,
                    total: int | None = None,
                    label: str = label,
                    case: int = count - 1,
                ) -> None:
                    say(message, done, total, case=case, label=label)

                case, quality, once = _inspected(options, case, told)
                found = work(case, once)
                once("done")
                found.json.update(quality)
                _deliver(options, name, found, wanted, apart=len(options.cases) > 1)
            except (FitError, ClusterError) as error:
                status = max(status, complain(f"{str(error).rstrip('.')} ({name})", FAILED))
            except InputError as error:
                if error.where.startswith("option"):
                    raise
                status = complain(error, WRONG)
            except (ArithmeticError, RuntimeError) as error:
                status = max(status, complain(unexpected(error, name), FAILED))
    return status


def _inspected(options: argparse.Namespace, case: Any, say: Say) -> tuple[Any, dict[str, Any], Say]:
    """`case` with the safe remedies for its defects; its JSON; and `say`, which first tells of them: options are judged
    before that, and anything is fitted after it.

    **Raises:** `InputError` where the recordings should not be fitted before a user has mended them.
    """
    from .._recording import Case

    if not isinstance(case, Case) or not hasattr(options, "as_recorded"):
        return case, {}, say
    from .._results import quality_json
    from .._text import quality_report
    from ..quality import inspected

    seen = inspected(case, options.as_recorded)
    left = [] if options.quiet or options.json == "-" else [quality_report(seen)]

    def once(message: str, done: int | None = None, total: int | None = None) -> None:
        while left:
            show(left.pop())
        say(message, done, total)

    try:
        seen.require_sound()
    except InputError:
        once("refused")
        raise
    return seen.case, {"quality": quality_json(seen)}, once


def _deliver(
    options: argparse.Namespace, name: str, found: Outcome, wanted: Mapping[str, Path | None], apart: bool
) -> None:
    from .._files import write_whole
    from .._json import as_text

    if name in wanted and (path := wanted[name]) is not None:
        write_whole(path, as_text(found.json))
    if options.out is not None:
        folder = Path(options.out) / name if apart else Path(options.out)
        write_whole(folder / f"{options.command}.json", as_text(found.json))
        found.write(folder)
    if name in wanted and wanted[name] is None:
        sys.stdout.write(as_text(found.json))
    elif not options.quiet:
        show(found.text)
