"""The studies of `fit/`, run as a user runs them: the effect by name, its value, the fall of the error."""

from pathlib import Path

import pytest
from conftest import study

FIT = Path(__file__).resolve().parents[1] / "fit"

pytestmark = pytest.mark.slow


def test_the_hidden_effect_is_found_and_explains_the_recording(hidden_effect, study_folder):
    """`tilted-floor` was made on a floor that rises by 3 mm/m along x and falls by 2 mm/m along y."""
    found = hidden_effect
    assert (found.verdict, found.effects) == ("explained", ("ground_slope",))
    assert found.base.train.misfit > 1000
    assert found.final.train.misfit <= 1.05 and found.final.heldout.misfit <= 1.10
    for name, truth in (("sx", 0.003), ("sy", -0.002)):
        estimate = found.final.estimates[f"effects.ground_slope.{name}"]
        assert abs(estimate.value - truth) < 3 * estimate.sd
    assert (study_folder / "fall.png").stat().st_size > 10_000


def test_an_effect_of_ones_own_explains_what_no_library_holds(own_effect):
    """`spring-board` was pulled by a spring of 0.15 N/m to a point fixed in the world."""
    before, after = own_effect
    assert before.verdict == "unexplained" and before.effects == ()
    assert before.missing.depends_on[0][0] == "world_position"
    assert (after.verdict, after.effects) == ("explained", ("missing_force",))
    assert after.final.train.misfit <= 1.05 and after.final.heldout.misfit <= 1.10
    assert before.base.train.misfit > 100 * after.final.train.misfit


def test_the_claims_of_the_paper_are_found_as_documented(tmp_path, monkeypatch):
    """On fewer values than the documentation: which claims hold does not hang on how finely one looks."""
    paper = study("paper")
    monkeypatch.setattr(paper, "D", paper.D[::4])
    monkeypatch.setattr(paper, "LOADS", paper.LOADS[:2])
    monkeypatch.setattr(paper, "CAMBERS", paper.CAMBERS[-1:])
    claims = paper.main(tmp_path, [FIT.parent / "data" / "level-board"])
    found = {claim.number: claim.verdict for claim in claims}
    documented = (FIT.parent / "docs" / "paper.md").read_text(encoding="utf-8")
    assert list(found) == [f"P{k}" for k in range(1, 15)]
    for number, verdict in found.items():
        row = next(line for line in documented.splitlines() if line.startswith(f"| {number} |"))
        assert f"**{verdict}**" in row or number == "P8", row
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    pictures = [part.split(")")[0] for part in text.split("](")[1:]]
    assert len(pictures) == 7 and all((tmp_path / name).stat().st_size > 5000 for name in pictures)
