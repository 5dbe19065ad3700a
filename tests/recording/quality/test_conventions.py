"""Axes and signs taken the other way are noticed by how the board turns, and mended by what the finding says."""

import shutil

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.folders import DATA, beside

from snakejax import check, load_case
from snakejax.recording.quality import CONVENTIONS, inspect

BUNDLED = sorted(path.parent for path in DATA.glob("*-*/case.toml"))
QUARTER = np.pi / 2
TURNED = {QUARTER: "left", 2 * QUARTER: "back", -QUARTER: "right"}
"""Where the x axis points whose heading is so far ahead of the board's."""


def turned(run, by):
    return eqx.tree_at(lambda r: r.pose, run, run.pose + jnp.array([[0.0, 0.0, by]]))


def negated(run, joint):
    return eqx.tree_at(lambda r: getattr(r.gait, joint).command.amplitude, run, replace_fn=lambda a: -a)


def mirrored(run):
    return eqx.tree_at(lambda r: r.pose, run, run.pose * jnp.array([[1.0, -1.0, -1.0]]))


def said(case, runs):
    """Kind, words and run of what is found in `runs`."""
    return [(f.kind, f.what, f.run) for f in inspect(eqx.tree_at(lambda c: c.runs, case, tuple(runs))).findings]


@pytest.fixture(scope="module", params=["bundled", pytest.param("recordings", marks=pytest.mark.long)])
def every_case(request):
    folders = BUNDLED if request.param == "bundled" else sorted(beside("recordings").glob("board-?"))
    return [load_case(folder) for folder in folders]


@pytest.mark.slow
def test_nothing_is_found_in_recordings_as_they_are(every_case):
    for case in every_case:
        assert not set(CONVENTIONS) & {kind for kind, *_ in said(case, case.runs)}


@pytest.mark.slow
@pytest.mark.parametrize("by", TURNED)
def test_an_axis_that_does_not_point_forward_is_found(every_case, by):
    for case in every_case:
        found = said(case, [turned(run, by) for run in case.runs])
        assert [(kind, what.endswith(f"pointed {TURNED[by]}"), run) for kind, what, run in found] == [
            ("turned_axis", True, None)
        ]


@pytest.mark.slow
def test_no_clock_is_blamed_for_an_axis():
    case = load_case(DATA / "level-board")
    runs = tuple(turned(run, QUARTER) for run in case.runs)
    (doubt,) = check(eqx.tree_at(lambda c: c.runs, case, runs))
    assert doubt.run is None and doubt.remedy.startswith('if so, write x_axis = "left"')


@pytest.mark.slow
def test_signs_taken_the_other_way_are_found(every_case):
    for case in every_case:
        assert [kind for kind, *_ in said(case, [negated(run, "psi") for run in case.runs])] == ["rotor_sign"]
        assert [kind for kind, *_ in said(case, [negated(run, "phi") for run in case.runs])] == ["turned_axis"]
        assert [kind for kind, *_ in said(case, [mirrored(run) for run in case.runs])] == ["mirrored"]
        both = [negated(negated(run, "phi"), "psi") for run in case.runs]
        assert [kind for kind, *_ in said(case, both)] == ["mirrored"]


@pytest.mark.parametrize("by", [QUARTER, *(pytest.param(by, marks=pytest.mark.slow) for by in TURNED if by != QUARTER)])
def test_one_run_turned_against_the_others_is_named(by):
    case = load_case(DATA / "level-board")
    for k, run in enumerate(case.runs):
        found = said(case, [turned(r, by) if j == k else r for j, r in enumerate(case.runs)])
        # A board that turns on the spot says little of the direction in which it rolls.
        assert (
            found == []
            if "rotate" in run.name
            else [(kind, run) for kind, _, run in found] == [("turned_axis", run.name)]
        )


def copied(folder, runs, key):
    """`level-board` with its first `runs`, and `key` in each."""
    case = (DATA / "level-board" / "case.toml").read_text(encoding="utf-8")
    head, *parts = case.split("[[runs]]")
    folder.mkdir()
    (folder / "case.toml").write_text(head + "".join(f"[[runs]]{part.rstrip()}\n{key}\n\n" for part in parts[:runs]))
    for path in (DATA / "level-board").glob("*.csv"):
        shutil.copy(path, folder)
    return folder


@pytest.mark.parametrize(("by", "points"), TURNED.items())
def test_the_key_that_is_named_mends_it(tmp_path, by, points):
    """Read with it, the heading is less by as much as the axis is ahead."""
    plain = load_case(copied(tmp_path / "plain", 2, ""))
    mended = load_case(copied(tmp_path / "mended", 2, f'x_axis = "{points}"'))
    for run, other in zip(plain.runs, mended.runs, strict=True):
        there = np.asarray(run.pose)
        np.testing.assert_allclose(np.asarray(other.pose), there - [0.0, 0.0, by], rtol=0, atol=1e-12)
    # These files were right before, so that now the finding names the way back.
    (found,) = said(mended, mended.runs)
    back = {"left": "right", "right": "left", "back": "back"}[points]
    assert found[1].endswith(f"pointed {back}")
