"""The studies of `fit/`, run as a user runs them: the effect by name, its value, the fall of the error."""

import numpy as np
import pytest
from helpers.browser import Seen, check, written
from helpers.folders import ROOT
from helpers.studies import study

from snakejax import simulate
from snakejax.core.parameter import own_parameters
from snakejax.present.as_json.explanation import explanation_json
from snakejax.present.as_json.provenance import provenance_json
from snakejax.present.report import explanation_page
from snakejax.present.views import views_of_steps

pytestmark = pytest.mark.slow


@pytest.mark.long
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


@pytest.mark.long
def test_the_law_of_what_no_library_holds_is_found_and_is_the_same_as_an_effect_of_ones_own(own_effect):
    """`spring-board` was pulled by a spring of 0.15 N/m to the point (0.5, 0.8) m of the world."""
    found, fit = own_effect
    assert (found.verdict, found.effects) == ("explained", ("law_1",))
    assert found.law.depends_on[0][0] == "world_position"
    assert found.named_laws["law_1"].expression == "east = k * (x0 - x); north = k * (y0 - y)"
    for name, truth in (("k", 0.15), ("x0", 0.5), ("y0", 0.8)):
        estimate = found.final.estimates[f"effects.law_1.{name}"]
        assert abs(estimate.value - truth) < 4 * estimate.sd
        own = fit.estimates[f"effects.missing_force.{name}"]
        assert abs(own.value - estimate.value) < estimate.sd, "Both fits end in one optimum, as well as it is known."
    model = found.final.model
    law, gait = model.effects["law_1"], found.case.runs[0].gait
    written = fit.model.effects["missing_force"]
    with_values = type(written)(**{name: value for name, (value, _) in own_parameters(law)})
    both = [model, model.without("law_1").add(missing_force=with_values)]
    poses = [simulate(one, gait, np.linspace(0.0, 5.0, 51), (0.1, 0.2, 0.3)).pose for one in both]
    np.testing.assert_allclose(*poses, rtol=0, atol=1e-9)
    assert found.final.train.misfit <= 1.05 and found.final.heldout.misfit <= 1.10
    assert found.base.train.misfit > 100 * found.final.train.misfit


@pytest.mark.long
@pytest.mark.parametrize("study", ["hidden_effect", "own_effect"])
def test_the_story_of_a_bundled_recording(study, request, browser, tmp_path) -> None:
    found = request.getfixturevalue(study)
    found = found[0] if isinstance(found, tuple) else found
    result = explanation_json(found, provenance_json(0, {}, found.case.sha256))
    seen = Seen(browser, written(tmp_path, explanation_page(found, result, views_of_steps(found))))
    page = seen.page
    assert found.case.name in page.inner_text("h1") and found.verdict in page.inner_text("h1")
    headings = [h.text_content() for h in page.query_selector_all("h2")]
    assert headings[0].startswith("Paths") and "Effects tried and refused" in headings
    assert ("The missing force" in headings) == (found.verdict == "unexplained")
    if found.missing is not None:
        shares = {t["variable"]: t["share"] for t in result["unexplained"]["depends_on"]}
        drawn = seen.traces("dependence")[0]
        assert {n: v / 100 for n, v in zip(drawn["y"], drawn["x"], strict=True)} == pytest.approx(shares, rel=1e-5)
    run = result["final"]["runs"][0]
    assert page.query_selector(f'tr[data-run="{run["run"]}"]') is not None
    check(seen)


@pytest.mark.long
def test_the_claims_of_the_paper_are_found_as_documented(tmp_path, monkeypatch):
    """On fewer values than the documentation: which claims hold does not hang on how finely one looks."""
    paper = study("paper")
    monkeypatch.setattr(paper, "D", paper.D[::4])
    monkeypatch.setattr(paper, "LOADS", paper.LOADS[:2])
    monkeypatch.setattr(paper, "CAMBERS", paper.CAMBERS[-1:])
    claims = paper.main(tmp_path, [ROOT / "data" / "level-board"])
    found = {claim.number: claim.verdict for claim in claims}
    documented = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    assert list(found) == [f"P{k}" for k in range(1, 15)]
    for number, verdict in found.items():
        row = next(line for line in documented.splitlines() if line.startswith(f"| {number} |"))
        assert f"**{verdict}**" in row or number == "P8", row
    text = (tmp_path / "paper.md").read_text(encoding="utf-8")
    pictures = [part.split(")")[0] for part in text.split("](")[1:]]
    assert len(pictures) == 7 and all((tmp_path / name).stat().st_size > 5000 for name in pictures)
