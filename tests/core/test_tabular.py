"""Tables of results: as text, in a notebook, as a data frame."""

import importlib
import xml.etree.ElementTree as ElementTree

import pytest

from snakejax import InputError
from snakejax.core.tabular import MOST_ROWS, Tabular, cell_text, first_few


class Counted(Tabular):
    """So many rows."""

    def __init__(self, rows: int) -> None:
        self.rows = rows

    def headline(self) -> str:
        return f"{self.rows} rows of <b>"

    def columns(self):
        return {"number <1>": list(range(self.rows)), "half": [k / 2 for k in range(self.rows)]}


def table_of(shown: str) -> tuple[list[str], list[list[str]]]:
    """The heads and the cells of a table in HTML."""
    root = ElementTree.fromstring(f"<div>{shown.replace('<br>', '<br/>')}</div>")
    heads = [cell.text or "" for cell in root.iter("th")]
    rows = [[cell.text or "" for cell in row.iter("td")] for row in root.iter("tr")]
    return heads, [row for row in rows if row]


def test_a_notebook_shows_headline_and_table_and_no_markup_of_a_name() -> None:
    shown = Counted(3)._repr_html_()
    assert table_of(shown) == (["number <1>", "half"], [["0", "0"], ["1", "0.5"], ["2", "1"]])
    assert "Counted: 3 rows of &lt;b&gt;" in shown and "more rows" not in shown


def test_a_long_table_is_cut_in_a_notebook_and_whole_as_data_frame() -> None:
    long = Counted(MOST_ROWS + 7)
    assert len(table_of(long._repr_html_())[1]) == MOST_ROWS and "7 more rows" in long._repr_html_()
    frame = long.to_dataframe()
    assert frame.shape == (MOST_ROWS + 7, 2) and frame["half"].sum() == sum(range(MOST_ROWS + 7)) / 2


def test_without_pandas_one_line_says_what_to_install(monkeypatch) -> None:
    known = importlib.import_module

    def missing(name: str, *rest):
        if name == "pandas":
            raise ImportError(name)
        return known(name, *rest)

    monkeypatch.setattr("snakejax.core.tabular.import_module", missing)
    with pytest.raises(InputError, match=r"Counted needs pandas.*pip install pandas") as raised:
        Counted(1).to_dataframe()
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, ""), (True, "yes"), (False, "no"), (3, "3"), (0.000123456, "0.0001235"), (float("nan"), "nan"), ("a", "a")],
)
def test_a_cell_has_four_digits(value, text) -> None:
    assert cell_text(value) == text


@pytest.mark.parametrize(
    ("names", "comma", "text"),
    [("", False, ""), ("ab", False, "a, b"), ("abcde", False, "a, b and 3 more"), ("abcde", True, "a, b, and 3 more")],
)
def test_a_long_list_shows_its_first_few(names: str, comma: bool, text: str) -> None:
    assert first_few(tuple(names), 2, comma) == text
