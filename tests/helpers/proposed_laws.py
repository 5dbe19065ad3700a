"""Laws as segments propose them, of which only what is asked of them is filled in."""

import numpy as np

from snakejax.diagnosis.inexact.fitted_law import Proposal
from snakejax.diagnosis.law.search import ProposedLaw
from snakejax.diagnosis.law.terms import Family, Term


def proposal(expression: str, action: str, variables: tuple[str, ...], penalised: float) -> Proposal:
    family, none = Family("", action, variables, (Term("a", {}, ((action, expression),)),)), np.zeros(0)
    law = ProposedLaw(expression, (), {}, family, none, 1.0, penalised, none)
    return Proposal(None, law, penalised)  # type: ignore[arg-type]
