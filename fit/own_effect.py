"""An effect of one's own, on `data/spring-board`: something pulls at that board which no library holds.

    python fit/own_effect.py [FOLDER]

writes figures, and the file with the effect, into FOLDER (default `docs/gallery`).
"""

import dataclasses
import sys
from pathlib import Path

import snakejax as sj

sj.prepare_jax()

from snakejax.diagnosis.law.source import law_source  # noqa: E402
from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.present import plot  # noqa: E402
from snakejax.present.as_text.errors import error_text  # noqa: E402

DATA = Path(__file__).resolve().parents[1] / "data"


def main(folder: Path) -> tuple[sj.Explanation, sj.Fit]:
    """The walk, step by step; returns what `explain` finds, and the fit with the effect of one's own."""
    case = sj.load_case(DATA / "spring-board")
    noise = sj.noise_of(case)
    candidates = {name: kind() for name, kind in LIBRARY.items()}

    # 1. No known effect explains the recording. The force that is missing is estimated, and its law is looked for.
    found = sj.diagnosis.explain(case, noise, candidates)
    assert found.law is not None
    print(f"{found.verdict}, error {error_text(found.final.train)}; the missing force depends on")
    for variable, share in found.law.depends_on[:3]:
        print(f"  {variable}: {100 * share:.0f} % of what is left")
    plot.save(plot.missing(dataclasses.replace(found, missing=found.law)), folder, "missing")
    plot.save(plot.fall(found), folder, "own_fall")

    # 2. The law is a file to go on from: a class of some 20 lines, its values those just found.
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "missing_force.py"
    file.write_text(law_source(found.named_laws["law_1"]))
    print(file.read_text())

    # 3. As an effect of one's own it gives the same model.
    sys.path.insert(0, str(folder))
    from missing_force import MissingForce

    model = found.final.model.without("law_1").add(missing_force=MissingForce())
    fit = sj.estimation.fit(model, case.runs, noise)
    for name, estimate in fit.estimates.items():
        print(f"  {name} = {estimate.value:.5g} +- {estimate.sd:.2g} {estimate.unit}")
    return found, fit


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "gallery")
