"""`snakejax sweep`: one parameter of a board, and the Rayleigh coefficient k_s that comes nearest to each value."""

import argparse
from pathlib import Path
from typing import Any

from .._errors import InputError, instead_of
from ._options import Varied, add_cases, add_command, add_loading, add_model, given, varied
from ._setup import Clock, Outcome, Say, each_case
from .fit import fitted

LOADING = ("load", "camber")
"""What `--vary` can name of the paper's gaits beside the parameters of a model."""


def add(commands: Any) -> None:
    """The command's options."""
    command = add_command(
        commands,
        "sweep",
        run,
        "one parameter against the Rayleigh coefficient k_s",
        "Vary one parameter of a board, find for each value the Rayleigh board that follows it\n"
        "best, and fit k_s as a polynomial of order 4. Without --set or --from a case is fitted first.",
        "snakejax sweep paper-rotate --vary D=0.5:10:41 --out out",
    )
    add_cases(command, presets=True)
    add_model(command)
    add_loading(command)
    command.add_argument(
        "--vary", metavar="D=0.5:10:41", required=True, help="a parameter, its first and last value, and how many"
    )
    command.add_argument("--run", metavar="RUN", dest="gait", help="the run whose gait it follows (default the first)")


def run(options: argparse.Namespace) -> int:
    """Sweep each CASE."""
    varied(options.vary)
    return each_case(options, lambda case, say: work(options, case, say), presets=True)


def work(options: argparse.Namespace, subject: Any, say: Say) -> Outcome:
    """Sweep one case or preset."""
    import numpy as np

    from .. import plot
    from .._json import clean, heading_json, provenance_json
    from .._presets import Preset
    from .._sweep import nearest_rayleigh

    clock = Clock()
    asked = varied(options.vary)
    values = np.linspace(asked.low, asked.high, asked.count)
    preset = isinstance(subject, Preset)
    gait, times = (subject.gait, subject.times) if preset else _gait(options, subject)
    models = _models(options, subject, asked, values, say)
    say(f"sweeping {asked.count} values of {asked.name}")
    found = nearest_rayleigh(models, values, gait, times)
    provenance = provenance_json(options.seed, given(options), {} if preset else subject.sha256)
    result = {
        **heading_json(subject.name, models[0], None, provenance),
        asked.name: found.values.tolist(),
        "k_s": found.k_s.tolist(),
        "mismatch": found.mismatch.tolist(),
        "polynomial": found.polynomial,
        "r_squared": found.r_squared,
        "fitted_range": found.fitted_range,
        "seconds": clock.seconds(),
    }

    def write(folder: Path) -> None:
        say("drawing")
        plot.save(plot.sweep(found, asked.name, subject.name), folder, "sweep")

    return Outcome(clean(result), _report(subject.name, asked.name, found), write)


def _gait(options: argparse.Namespace, case: Any) -> tuple[Any, Any]:
    """Gait and times of the run asked for."""
    names = [run_.name for run_ in case.runs]
    name = names[0] if options.gait is None else options.gait
    if name not in names:
        raise InputError(f"There is no run `{name}` in {case.name}", "option --run", instead_of(name, names))
    found = case.runs[names.index(name)]
    return found.gait, found.times


def _models(options: argparse.Namespace, subject: Any, asked: Varied, values: Any, say: Say) -> list[Any]:
    """The model at each value."""
    from .._presets import Preset, preset
    from .._tyre import Bakker, Rayleigh
    from ._models import require_given, valued, wanted_model

    if asked.name in LOADING:
        if not isinstance(subject, Preset):
            what = f"`{asked.name}` is varied on paper-gait1 and paper-gait2 alone"
            raise InputError(what, "option --vary", "name one of those as CASE")
        loading = {"load": options.load, "camber": options.camber}
        presets = [preset(subject.name, **{**loading, asked.name: float(value)}) for value in values]
        return [wanted_model(options, one).model for one in presets]
    wanted = wanted_model(options, subject)
    if isinstance(subject, Preset) or options.set or options.saved:
        require_given(options, wanted, own=isinstance(subject, Preset) and options.model is None)
        model = wanted.model
    else:
        model = fitted(options, subject, say)[0].model
    if isinstance(model.tyre, Rayleigh):
        what = "A Rayleigh board needs no other to come near it"
        raise InputError(what, "option --model", "vary the parameters of a Pacejka board")
    if isinstance(model.tyre, Bakker):
        model = type(model)(model.board, model.tyre.coefficients(), model.skid, model.effects)
    return [valued(model, {asked.name: float(value)}, "option --vary") for value in values]


def _report(name: str, varied_name: str, found: Any) -> Any:
    import numpy as np
    from rich.console import Group
    from rich.text import Text

    from .._text import add_row, plain_table

    table = plain_table(varied_name, "k_s [N s/m]", "mismatch", right=(varied_name, "k_s [N s/m]", "mismatch"))
    rows = np.unique(np.linspace(0, len(found.values) - 1, min(len(found.values), 21)).round().astype(int))
    for k in rows:
        k_s = f"{found.k_s[k]:.4g}" if np.isfinite(found.k_s[k]) else "none fits"
        add_row(table, f"{found.values[k]:.4g}", k_s, f"{100 * found.mismatch[k]:.2g} %")
    lines: list[Any] = [Text(name, style="bold"), table]
    if found.polynomial is None:
        lines.append(Text("Too few values have a k_s for a polynomial."))
    else:
        terms = " ".join(f"{c:+.4g} {varied_name}^{p}" for p, c in zip(range(4, -1, -1), found.polynomial, strict=True))
        low, high = found.fitted_range
        lines.append(Text(f"k_s = {terms}, {varied_name} from {low:.4g} to {high:.4g}, R^2 = {found.r_squared:.5f}"))
    return Group(*lines)
