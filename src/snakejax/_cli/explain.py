"""`snakejax explain`: the whole loop, from the first misfit to what was missing."""

import argparse
from pathlib import Path
from typing import Any

from .._errors import InputError, instead_of
from ._films import add_films, films, require_films
from ._options import SKIDS, add_cases, add_command, effect_spec, given
from ._progress import Say
from ._setup import Clock, Outcome, each_case


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "explain",
        run,
        "find out which physical effect is missing",
        "Fit, see what is left, add the effect that explains it, and fit again, until\n"
        "only noise is left or nothing known helps.",
        "snakejax explain data/tilted-floor --json -",
    )
    add_cases(command)
    add_candidates(command)
    add_films(command)


def add_candidates(command: argparse.ArgumentParser) -> None:
    """The options that say which base and which candidates; `diagnose` has them too."""
    command.add_argument("--model", choices=("pacejka", "rayleigh"), default="pacejka", help="tyre law to start from")
    command.add_argument("--skid", choices=SKIDS[:2], help="skid structure to start from (default that of CASE)")
    command.add_argument("--effect", metavar="FILE.py:Class", action="append", help="one more candidate of your own")
    command.add_argument("--with", dest="with_", metavar="NAME", action="append", help="an effect to start with")
    command.add_argument("--without", metavar="NAME", action="append", help="an effect that is no candidate")


def run(options: argparse.Namespace) -> int:
    """Explain each CASE."""
    require_films(options)
    return each_case(options, lambda case, say: work(options, case, say))


def library(options: argparse.Namespace) -> dict[str, Any]:
    """The candidates: those built in less `--without`, and those of `--effect`. **Raises:** `InputError`."""
    from .._bench import LATERAL_SKID
    from ..effects import LIBRARY
    from ._models import effect_class

    found = {name: kind() for name, kind in LIBRARY.items()}
    for text in options.effect or ():
        spec = effect_spec(text)
        found[spec.name] = effect_class(spec)()
    for option in ("with_", "without"):
        for name in getattr(options, option) or ():
            if name not in found and name != LATERAL_SKID:
                where = f"option --{option.rstrip('_')}"
                raise InputError(f"There is no effect `{name}`", where, instead_of(name, [*found, LATERAL_SKID]))
    return {name: effect for name, effect in found.items() if name not in (options.without or ())}


def wanted(options: argparse.Namespace) -> dict[str, Any]:
    """The options of `explain()` and `diagnose()`."""
    from .._bench import LATERAL_SKID

    with_ = options.with_ or []
    return {
        "kind": options.model,
        "skid": "free" if LATERAL_SKID in with_ else options.skid,
        "with_": [name for name in with_ if name != LATERAL_SKID],
        "switch": LATERAL_SKID not in (options.without or ()),
    }


def work(options: argparse.Namespace, case: Any, say: Say) -> Outcome:
    """Explain one case."""
    from .. import plot
    from .._explain import explain
    from .._files import write_whole
    from .._played import played_stages
    from .._provenance import provenance_json
    from .._results import joint_logs_json
    from .._starter import starter
    from .._story import explanation_json, explanation_text
    from ..quality import noise_of
    from ..report import explanation_page

    clock = Clock()
    noise = noise_of(case)
    found = explain(case, noise, library(options), **wanted(options), progress=say)
    provenance = provenance_json(options.seed, given(options), case.sha256)

    result = {**explanation_json(found, provenance, clock.seconds()), **joint_logs_json(found.case.runs)}

    def write(folder: Path) -> None:
        say("drawing")
        models = list(played_stages(found))
        write_whole(folder / "explain.html", explanation_page(found, result, models))
        plot.save(plot.fall(found, models), folder, "fall")
        plot.save(plot.waterfall(found), folder, "waterfall")
        ends = models if len(models) < 3 else [models[0], models[-1]]
        plot.save(plot.paths(ends), folder, "paths")
        plot.save(plot.residuals(models[-1]), folder, "residuals")
        plot.save(plot.tyre(ends), folder, "tyre")
        plot.save(plot.ranking(found.base), folder, "ranking")
        plot.save(plot.confusability(found.base), folder, "confusability")
        films(options, models[-1], case.board, folder, say)
        if found.missing is None:
            return
        plot.save(plot.missing(found), folder, "missing")
        if found.missing.shape is not None:
            write_whole(folder / "missing_force.py", starter(found.missing))

    return Outcome(result, explanation_text(found), write)
