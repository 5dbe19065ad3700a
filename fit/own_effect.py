"""An effect of one's own, on `data/spring-board`: something pulls at that board which no library holds.

    python fit/own_effect.py [FOLDER]

writes figures, and the file with the effect, into FOLDER (default `docs/gallery`).
"""

import sys
from pathlib import Path

import snakejax as sj

sj.prepare_jax()

from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.present import plot  # noqa: E402
from snakejax.present.as_text.errors import error_text  # noqa: E402

DATA = Path(__file__).resolve().parents[1] / "data"


def main(folder: Path) -> tuple[sj.Explanation, sj.Explanation]:
    """The walk, step by step; returns what the library explains, and what the effect of one's own does."""
    case = sj.load_case(DATA / "spring-board")
    noise = sj.noise_of(case)
    candidates = {name: kind() for name, kind in LIBRARY.items()}

    # 1. No known effect explains the recording. The force that is missing is estimated instead, and what it depends on.
    before = sj.diagnosis.explain(case, noise, candidates)
    assert before.missing is not None
    print(f"{before.verdict}, error {error_text(before.final.train)}; the missing force depends on")
    for variable, share in before.missing.depends_on[:3]:
        print(f"  {variable}: {100 * share:.0f} % of what is left")
    plot.save(plot.missing(before), folder, "missing")

    # 2. That is a file to start from: a class of some 20 lines, its values those just found. Here it is used as it is.
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "missing_force.py"
    file.write_text(sj.effect_template(before.missing))
    print(file.read_text())

    # 3. It competes with those that had helped, and explains the recording.
    sys.path.insert(0, str(folder))
    from missing_force import MissingForce

    rivals = {name: candidates[name] for name in before.partial}
    after = sj.diagnosis.explain(case, noise, {**rivals, "missing_force": MissingForce()})
    print(f"{after.verdict}: {', '.join(after.effects)}, error {error_text(after.final.train)}")
    for name, estimate in after.final.estimates.items():
        print(f"  {name} = {estimate.value:.5g} +- {estimate.sd:.2g} {estimate.unit}")
    plot.save(plot.fall(after), folder, "own_fall")
    return before, after


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "gallery")
