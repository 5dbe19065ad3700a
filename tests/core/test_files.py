"""Files are written whole."""

from pathlib import Path

import pytest

from snakejax.core.files import write_whole


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = write_whole(tmp_path / "sub" / "a.json", "before")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "after \udc80")
    assert path.read_text() == "before"
    assert list(path.parent.iterdir()) == [path]
