"""How good a recording is: its defects, what is done about them before a fit, and its noise."""

from .finding import Finding as Finding
from .finding import Track as Track
from .remedy import Inspection as Inspection
from .remedy import inspect_run as inspect_run
from .remedy import mended as mended
