"""How good a recording is: its defects, what is done about them before a fit, and its noise.

A detector is a function of the times and poses of one run (a `Track`) that returns findings. To add one: write it in
the file that fits, name it in `inspect` of `remedy.py`, and give it a row in docs/quality.md and an injection with its
sizes in tests/systems/defects.py.
"""

from .conventions import CONVENTIONS as CONVENTIONS
from .finding import Finding as Finding
from .finding import Track as Track
from .joints import angles as angles
from .lag import clocks as clocks
from .lag import lag as lag
from .lag import with_log_clock as with_log_clock
from .logs import Smoothed as Smoothed
from .logs import smoothed as smoothed
from .logs import smoothed_again as smoothed_again
from .noise import estimate_noise as estimate_noise
from .noise import marker_noise as marker_noise
from .noise import noise_of as noise_of
from .noise import noise_sources as noise_sources
from .remedy import Inspection as Inspection
from .remedy import inspect_run as inspect_run
from .remedy import inspected as inspected
