"""How good a recording is: its defects, what is done about them before a fit, and its noise.

A detector is a function of the times and poses of one run (a `PoseSeries`) that returns findings. To add one: write it
in the file that fits, name it in `find_defects` of `inspection.py`, and give it a row in docs/quality.md and an
injection with its sizes in tests/oracles/defects.py.
"""

from .brief import in_brief as in_brief
from .clock_lag import clocks as clocks
from .clock_lag import lag as lag
from .clock_lag import with_log_clock as with_log_clock
from .conventions import CONVENTIONS as CONVENTIONS
from .finding import Finding as Finding
from .finding import PoseSeries as PoseSeries
from .inspection import Inspection as Inspection
from .inspection import inspect as inspect
from .inspection import inspect_run as inspect_run
from .joint_motion import angles as angles
from .log_smoothing import Smoothed as Smoothed
from .log_smoothing import smoothed as smoothed
from .log_smoothing import smoothed_again as smoothed_again
from .noise import estimate_noise as estimate_noise
from .noise import marker_noise as marker_noise
from .noise import noise_of as noise_of
from .noise import noise_sources as noise_sources
from .steering_unit import farthest_steering as farthest_steering
