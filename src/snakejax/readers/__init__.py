"""Motion capture from files, one format a module. To add one: write `recognises` and `parse` and name it in FORMATS."""

from pathlib import Path

from .._errors import InputError, at_line
from . import vicon_tracker as vicon_tracker
from ._text import FEWEST_SAMPLES as FEWEST_SAMPLES
from ._text import Track as Track
from ._text import read_text
from .joint_log import JointLog as JointLog
from .joint_log import read_joint_log as read_joint_log

FORMATS = (vicon_tracker,)


def read_track(path: Path | str, object: str) -> Track:
    """The motion of `object` in the file at `path`, whose content says which format it is.

    **Raises:** `InputError` with file, line and remedy.
    """
    path = Path(path)
    text = read_text(path)
    for reader in FORMATS:
        if reader.recognises(text):
            return reader.parse(text, path, object)
    begins = text.lstrip().split("\n")[0][:40].strip()
    raise InputError(
        f'No known format: the file begins with "{begins}"',
        at_line(path, 1),
        "export it from Vicon Tracker as CSV, whose first row is Objects or Segments",
    )
