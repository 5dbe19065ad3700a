"""From the first error to the missing effect, on `data/tilted-floor`: a board that was recorded on a floor not level.

    python fit/hidden_effect.py [FOLDER]

writes the figure of each step into FOLDER (default `docs/gallery`).
"""

import sys
from pathlib import Path

import snakejax as sj

sj.prepare_jax()

from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.present import plot  # noqa: E402
from snakejax.present.as_text.errors import error_text  # noqa: E402

DATA = Path(__file__).resolve().parents[1] / "data"


def main(folder: Path) -> sj.Explanation:
    """The walk, step by step; returns the explanation."""
    # 1. Read the recording: runs to learn from and runs held out, poses in metres and radians, the commanded gait.
    case = sj.load_case(DATA / "tilted-floor")
    noise = sj.noise_of(case)

    # 2. Let the package do what a careful experimenter would: fit the tyre, look at what is left, score every known
    #    effect beside it, add the one that explains most, fit again, and stop when only noise is left.
    candidates = {name: kind() for name, kind in LIBRARY.items()}
    found = sj.diagnosis.explain(case, noise, candidates, show=tell)

    # 3. The verdict, with the size of the effect and its standard error.
    print(f"{found.verdict}: {', '.join(found.effects)}")
    for name, estimate in found.final.estimates.items():
        print(f"  {name} = {estimate.value:.6g} +- {estimate.sd:.2g} {estimate.unit}")

    # 4. The picture: the held-out path before and after, and the error falling to the noise.
    plot.save(plot.fall(found), folder, "fall")
    return found


def tell(step: sj.SelectionStep) -> None:
    """One line a step."""
    held = "" if step.heldout is None else f", held out {error_text(step.heldout)}"
    doubt = "" if step.converged else "; the fit did not converge"
    print(f"{step.change} {step.name}: root mean square error {error_text(step.train)}{held}{doubt}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "gallery")
