"""Motion capture from files, one format a module. To add one: write `recognises` and `read` and name it in FORMATS."""

from pathlib import Path

from .._errors import InputError, at_line
from . import c3d, motive, parquet, plain, qualisys, ros_bag, trc, vicon
from ._capture import POINTING as POINTING
from ._capture import Body as Body
from ._capture import Capture as Capture
from ._capture import Hints as Hints
from ._capture import Source
from ._text import shown
from ._track import FEWEST_SAMPLES as FEWEST_SAMPLES
from ._track import Track as Track
from ._track import track_of as track_of
from ._turn import UPRIGHT as UPRIGHT
from ._write import write_csv as write_csv
from ._write import write_tum as write_tum
from .joint_log import JointLog as JointLog
from .joint_log import read_joint_log as read_joint_log

FORMATS = (ros_bag, c3d, parquet, motive, qualisys, trc, vicon, plain)
NO_HINTS = Hints()
KNOWN = "Vicon CSV, C3D, TRC, Motive CSV, Qualisys TSV, a ROS bag, or a table with named columns"


def read_capture(path: Path | str, hints: Hints = NO_HINTS) -> Capture:
    """All that the file at `path` holds; its content says which format it is, and `hints` what it leaves open.

    **Raises:** `InputError` with file, line and remedy.
    """
    source = Source(Path(path), hints)
    for reader in FORMATS:
        if reader.recognises(source):
            return reader.read(source)
    begins = shown(source.text.lstrip().split("\n")[0].strip())
    remedy = f"export it as one of {KNOWN}"
    raise InputError(f'No known format: the file begins with "{begins}"', at_line(path, 1), remedy)


def read_track(path: Path | str, object: str, hints: Hints = NO_HINTS) -> Track:
    """The motion of `object` in the file at `path`, whose content says which format it is.

    **Raises:** `InputError` with file, line and remedy.
    """
    return track_of(read_capture(path, hints), object, hints)
