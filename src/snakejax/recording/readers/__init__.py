"""Motion capture from files, one format a module. To add one: write `recognises` and `read` and name it in FORMATS."""

from pathlib import Path

from snakejax.core.errors import InputError, at_line

from . import c3d, motive, parquet, plain, qualisys, ros_bag, trc, vicon
from .angles import ANGLES as ANGLES
from .capture import X_AXIS_DIRECTIONS as X_AXIS_DIRECTIONS
from .capture import Body as Body
from .capture import Capture as Capture
from .capture import FileAnnotations as FileAnnotations
from .capture import Source
from .cells import shown
from .export import write_csv as write_csv
from .export import write_tum as write_tum
from .input_log import InputLog as InputLog
from .input_log import JointLog as JointLog
from .input_log import read_input_log as read_input_log
from .input_log import read_joint_log as read_joint_log
from .planar_pose import FEWEST_SAMPLES as FEWEST_SAMPLES
from .planar_pose import PoseTrack as PoseTrack
from .planar_pose import pose_track as pose_track
from .rotations import UPRIGHT as UPRIGHT

FORMATS = (ros_bag, c3d, parquet, motive, qualisys, trc, vicon, plain)
NO_HINTS = FileAnnotations()
KNOWN = "Vicon CSV, C3D, TRC, Motive CSV, Qualisys TSV, a ROS bag, or a table with named columns"


def read_capture(path: Path | str, hints: FileAnnotations = NO_HINTS) -> Capture:
    """Read the file at `path`; its format is recognised from its content. `hints`: see `FileAnnotations`.

    **Raises:** `InputError` with file, line and remedy.
    """
    source = Source(Path(path), hints)
    for reader in FORMATS:
        if reader.recognises(source):
            return reader.read(source)
    begins = shown(source.text.lstrip().split("\n")[0].strip())
    remedy = f"export it as one of {KNOWN}"
    raise InputError(f'No known format: the file begins with "{begins}"', at_line(path, 1), remedy)


def read_track(path: Path | str, object: str, hints: FileAnnotations = NO_HINTS) -> PoseTrack:
    """The planar motion of `object` in the file at `path`; the format is recognised from its content.

    **Raises:** `InputError` with file, line and remedy.
    """
    return pose_track(read_capture(path, hints), object, hints)
