"""Progress of a computation, as events: the phase, a sentence about it, and a count where one is known."""

import enum
from collections.abc import Callable
from typing import NamedTuple


class Phase(enum.Enum):
    """What a computation is doing. The value is the sentence shown for an event without a text of its own."""

    READING = "reading"
    CHECKING = "checking"
    # Estimation
    FIRST_SECONDS = "first seconds"
    LONGER_HORIZON = "more seconds"
    WINDOWS = "fitting windows"
    WHOLE_RUNS = "fitting whole runs"
    TIGHTER_TOLERANCES = "fitting whole runs more accurately"
    LOG_CLOCKS = "aligning the clocks of the joint logs"
    LOG_NOISE = "propagating the noise of the joint logs"
    LOG_CLOCK_ERRORS = "finding what the joint logs leave undetermined"
    START_STATES = "estimating the start states of the runs"
    PROFILE = "profile likelihood"
    BOOTSTRAP = "refitting to made-up recordings"
    POSTERIOR_SAMPLES = "sampling parameters from the fit"
    # Diagnosis
    COMPARISON = "comparing"
    OTHER_MODELS = "fitting other models"
    SCORE_TESTS = "scoring candidates"
    SCREENING = "screening on windows"
    SCREENING_CANDIDATES = "fitting candidates on windows"
    REFITTING_CANDIDATES = "refitting candidates on whole runs"
    REFITTING_OTHER_STRUCTURE = "refitting with the other structure"
    PREDICTION = "predicting omitted runs"
    BEAM_SEARCH = "searching for sets of effects"
    REFITTING_SETS = "refitting sets of effects on whole runs"
    ELIMINATION = "refitting without each effect"
    LATENT_FORCE = "estimating the missing force"
    FORCE_REGRESSION = "finding the variable of the missing force"
    LAW_SEARCH = "searching for the law of the missing force"
    LAW_FIT = "fitting the law to whole runs"
    COEXISTING_EFFECTS = "testing effects together with the missing force"
    TYRE_BESIDE_FORCE = "fitting the tyre together with a random force"
    CHOOSING_EFFECTS = "choosing effects together with a random force"
    FITTING_EFFECTS = "fitting the chosen effects together with a random force"
    PREDICTIVE_CHECK = "predicting the held-out runs"
    # Simulation and design
    SIMULATION = "simulating"
    SWEEP = "sweeping"
    PRIOR_INFORMATION = "computing the information of the given runs"
    OPTIMISATION = "optimising the gait"
    # Output
    DRAWING = "drawing"
    ANIMATION = "rendering the animation"


class ProgressEvent(NamedTuple):
    """One report of progress: the `phase`, its `text` (default: the sentence of the phase), and `done` of `total`.

    `str(event)` is the sentence, with the count where there is one.
    """

    phase: Phase
    text: str = ""
    done: int | None = None
    total: int | None = None

    @property
    def sentence(self) -> str:
        """What is being done, without the count."""
        return self.text or self.phase.value

    def __str__(self) -> str:
        return self.sentence if self.total is None else f"{self.sentence} ({self.done} of {self.total})"


Progress = Callable[[ProgressEvent], None]
"""What is called with each event; `print` is one."""


def no_progress(_: object) -> None:
    """Report nothing."""
