"""What the model of a real car lacks, on `data/car`: ten recordings by Vicon of a 1:10 car that wanders.

    python fit/real_car.py [FOLDER]

writes the figure of each step into FOLDER (default `docs/gallery`).
"""

import json
import sys
from pathlib import Path

import snakejax as sj

sj.prepare_jax()

from snakejax.commands.predicting import PredictionResult  # noqa: E402
from snakejax.present import plot  # noqa: E402
from snakejax.present.as_json.explanation import explanation_json  # noqa: E402
from snakejax.present.as_json.provenance import provenance_json  # noqa: E402
from snakejax.present.as_text.errors import error_text  # noqa: E402
from snakejax.present.views import views_of_steps  # noqa: E402

CAR = Path(__file__).resolve().parents[1] / "data" / "car"


def main(folder: Path) -> tuple[sj.Explanation, PredictionResult]:
    """The walk, step by step; returns the explanation and the errors of its models' predictions."""
    # 1. Start from a car that does not slip, and add what predicts recordings left out better, until nothing does.
    found = sj.explain(CAR)
    for step in found.steps:
        print(f"{step.title}: train windows {error_text(step.train)}, held out {error_text(step.heldout)}")
    for effect, sure in found.confidence.items():
        print(f"  {effect}: {sure}")

    # 2. The error of each step, and the paths of the first and of the last model.
    models = views_of_steps(found)
    plot.save(plot.waterfall(found), folder, "car-error")
    plot.save(plot.paths([models[0], models[-1]]), folder, "car-paths")

    # 3. How far off each model is 1 and 2 s after half a second of lead-in, in recordings that no fit has seen.
    result = folder / "car.json"
    result.write_text(json.dumps(explanation_json(found, provenance_json(0, {}, found.case.sha256))))
    ahead = sj.predict(CAR, result, (1.0, 2.0))
    plot.save(plot.prediction(ahead.groups, found.case.title), folder, "car-prediction")
    for group, by_model in ahead.groups.items():
        for name in ("base", "final"):
            for seconds, off in by_model[name].items():
                print(f"{group}, {name}, {seconds} s: {1e3 * off.position:.0f} mm, {1e3 * off.heading:.0f} mrad")
    result.unlink()
    return found, ahead


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "gallery")
