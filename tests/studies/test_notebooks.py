"""The notebooks of docs/notebooks run from their first cell to the last, and end where their text says.

To renew their outputs after a change that is wanted, run SNAKEJAX_NEW_NOTEBOOKS=1 python -m pytest with this file, and
look at them.
"""

import os
from pathlib import Path

import pytest
from helpers.folders import ROOT

FOLDER = ROOT / "docs" / "notebooks"
SAYS = {
    "fit-and-explain": ("explained ('ground_slope',)", "effects.ground_slope.sx = 0.00300", "sy = -0.00200"),
    "own-effect": ("explained by cable", "k = 0.39"),
    "sweep": ("mismatch",),
}
"""By notebook, what its outputs hold."""


def test_every_notebook_is_run() -> None:
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(SAYS)


@pytest.mark.slow
@pytest.mark.parametrize("name", SAYS)
def test_a_notebook_runs_and_ends_as_its_text_says(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat", reason="Notebooks need the extra `test`.")
    nbclient = pytest.importorskip("nbclient", reason="Notebooks need the extra `test`.")
    pytest.importorskip("ipykernel", reason="Notebooks need the extra `test`.")
    for variable in ("JAX_NUMPY_DTYPE_PROMOTION", "JAX_NUMPY_RANK_PROMOTION"):
        monkeypatch.delenv(variable, raising=False)  # users have JAX as it comes
    path = FOLDER / f"{name}.ipynb"
    notebook = nbformat.read(path, as_version=4)
    kept = said(notebook)
    where = {"metadata": {"path": str(FOLDER)}}
    nbclient.NotebookClient(notebook, timeout=1200, kernel_name="python3", resources=where).execute()
    if os.environ.get("SNAKEJAX_NEW_NOTEBOOKS"):
        kept = said(notebook)
        write(notebook, path)
    for text in (said(notebook), kept):
        assert [part for part in SAYS[name] if part not in text] == []


def said(notebook) -> str:
    """The text of all outputs."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [output for output in outputs if output.get("name") == "stderr"], "A notebook warns."
    return "\n".join(output.get("text") or output.get("data", {}).get("text/plain", "") for output in outputs)


def write(notebook, path: Path) -> None:
    """Without what differs from run to run: times of execution, names of the machine."""
    import nbformat

    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"], "language_info": {"name": "python"}}
    nbformat.write(notebook, path)
