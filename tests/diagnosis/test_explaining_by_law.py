"""Which known effect a law may stand beside; laws themselves are tested in `tests/diagnosis/law`."""

from types import SimpleNamespace
from typing import Any

import pytest

from snakejax.diagnosis import explaining_by_law


class Force(str):
    """A missing force, by the effect beside which it was found."""

    def with_also(self, laws):
        return self


@pytest.mark.parametrize(
    ("with_noise_alone", "tried", "found"),
    [
        ("yaw_friction", ["yaw_friction"], "yaw_friction"),
        ("ground_slope", ["yaw_friction", "ground_slope"], "ground_slope"),
        ("yaw_bias", ["yaw_friction", "ground_slope"], None),
    ],
)
def test_a_law_is_looked_for_beside_the_best_known_effects_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch, with_noise_alone: str, tried: list[str], found: str | None
) -> None:
    """Those whose refit failed or was not made are passed over; the first that leaves only noise of the train runs is
    the explanation, whatever held-out runs say: they judge it, and choose no other."""
    rows = [
        SimpleNamespace(effect="steering_lag", refit="solution", failed=True),
        SimpleNamespace(effect="yaw_friction", refit="solution", failed=False),
        SimpleNamespace(effect="ground_slope", refit="solution", failed=False),
        SimpleNamespace(effect="yaw_bias", refit="solution", failed=False),
    ]
    base: Any = SimpleNamespace(
        step=SimpleNamespace(effects=()), ranking=rows, candidate_set=SimpleNamespace(criteria="criteria")
    )
    diagnosis: Any = SimpleNamespace(base=base)
    beside: list[str] = []

    def force(candidate_set, step, progress):
        (effect,) = step.effects
        beside.append(effect)
        return SimpleNamespace(with_laws=lambda: Force(effect))

    def law(case, noise, like, missing, progress):
        assert like == missing, "the law is added to the model in which its force was found"
        if missing != with_noise_alone:
            return None
        return SimpleNamespace(candidate_set="", names=("law_1",), fit="", laws=())

    def conclusion(case, noise, own, steps, missing):
        return SimpleNamespace(verdict="unexplained", steps=steps)

    monkeypatch.setattr(explaining_by_law, "trial_order", lambda ranking, criteria: list(ranking))
    monkeypatch.setattr(explaining_by_law, "estimate_latent_force", force)
    monkeypatch.setattr(explaining_by_law, "selection_step", lambda _, change, name, step: name)
    monkeypatch.setattr(explaining_by_law, "exact_law", law)
    monkeypatch.setattr(explaining_by_law, "conclude_with_law", conclusion)
    explanation: Any = explaining_by_law.by_exact_law_beside(None, None, diagnosis, lambda _: None)  # type: ignore[arg-type]
    assert beside == tried
    assert (explanation and explanation.steps) == (found and [found, "law_1"])
