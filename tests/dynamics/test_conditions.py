"""Parameters that differ between labels of the runs."""

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Gait, InputError, Model, Pacejka, Run, Sines, simulate
from snakejax.core.parameter import parameters
from snakejax.dynamics.conditions import FURTHEST, by_condition, codes_of, differences_of
from snakejax.dynamics.kinds import LABELS

GAIT = Gait(Sines.of([[0.35, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.4]]))
TIMES = jnp.arange(100.0) * 0.02


def model(D: float = 0.9, E: float = 0.2, mass: float = 7.0) -> Model:
    """A board that slips past the peak of its tyre."""
    return Model(Board(**{**TABLE_II, "mass": mass}), Pacejka(8.0, 1.3, D, E), "free")


def by_floor(base: Model, names: list[str], values: dict[str, float], called: str | None = None) -> Model:
    """`base` with other values on the floors "rubber" and "wet floor"."""
    differences = differences_of(base, names, ("rubber", "wet floor"), called)
    return base.add(by_floor=by_condition("floor", differences)(**values))


def labelled(**labels: str) -> Run:
    """A run of no length with these labels."""
    return Run("a", "train", TIMES, jnp.zeros((100, 3)), GAIT, labels=tuple(labels.items()))


def pose(of: Model, run: Run) -> np.ndarray:
    """The path of `of` in `run`."""
    return np.asarray(simulate(of.in_run(run.payload, run.codes), run.gait, run.times).pose)


def test_a_labelled_run_has_its_own_values_and_any_other_those_of_the_model() -> None:
    other = by_floor(model(), ["tyre.D", "tyre.E"], {"D_rubber": 1.4, "E_rubber": -0.3, "D_wet_floor": 0.5})
    assert set(parameters(other.effects["by_floor"])) == {"D_rubber", "E_rubber", "D_wet_floor", "E_wet_floor"}
    for labels, D, E in (
        ({"floor": "rubber"}, 1.26, -0.1),
        ({"floor": "wet floor", "day": "monday"}, 0.45, 0.2),
        ({"floor": "concrete"}, 0.9, 0.2),
        ({"day": "rubber"}, 0.9, 0.2),
        ({}, 0.9, 0.2),
    ):
        np.testing.assert_allclose(pose(other, labelled(**labels)), pose(model(D, E), labelled()), rtol=0, atol=1e-12)


def test_one_ratio_for_several_parameters_and_the_payload_beside_it() -> None:
    other = by_floor(model(), ["tyre.D", "board.mass"], {"load_rubber": 1.1}, "load")
    np.testing.assert_allclose(
        pose(other, labelled(floor="rubber")), pose(model(0.99, mass=7.7), labelled()), rtol=0, atol=1e-12
    )


def test_what_is_multiplied_and_what_is_added_stays_inside_its_domain() -> None:
    grip, shape = differences_of(model(), ["tyre.D", "tyre.E"], ["rubber"])
    assert (grip.relative, grip.unit, grip.low, grip.high) == (True, "-", 1 / FURTHEST, FURTHEST)
    low, high = (getattr(parameters(model())["tyre.E"].domain, end) for end in ("low", "high"))
    assert (shape.relative, shape.low, shape.high) == (False, low - 0.2, high - 0.2)


def test_labels_are_told_apart_by_key_and_text() -> None:
    codes = {tuple(codes_of({key: label})) for key in LABELS for label in ("a", "b", "a ")}
    assert len(codes) == 3 * len(LABELS)
    assert not codes_of({}).any()


def test_a_parameter_that_the_model_lacks_is_refused() -> None:
    (grip,) = differences_of(model(), ["tyre.D"], ["rubber"])
    other = by_condition("floor", (grip._replace(names=("tyre.front.D",)),))()
    with pytest.raises(ValueError, match=r"no parameter `tyre\.front\.D`"):
        model().add(by_floor=other)


def test_labels_that_give_one_name_are_refused() -> None:
    with pytest.raises(InputError, match="differ in punctuation alone"):
        by_condition("floor", differences_of(model(), ["tyre.D"], ["wet floor", "wet-floor"]))
