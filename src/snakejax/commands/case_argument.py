"""What a Python function that takes a case does first, as the commands do: read it, inspect it, mend it."""

import functools
import inspect
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from snakejax.core.errors import InputError, instead_of
from snakejax.core.jax_config import prepare_jax
from snakejax.dynamics.model import Model
from snakejax.recording.case import load_case
from snakejax.recording.quality import in_brief
from snakejax.recording.quality import inspect as inspected
from snakejax.recording.run import Case
from snakejax.vehicles.snakeboard.paper_examples import PRESETS, Preset, preset

F = TypeVar("F", bound=Callable[..., Any])


def sound_case(case: Case | Path | str, as_recorded: bool = False) -> Case:
    """`case`, read where it is a folder, without the frames that `inspect` finds wrong; each finding is a warning.

    Sets up JAX by `prepare_jax`. **Raises:** `InputError` where the case cannot be read, or holds a defect with which
    nothing should be fitted.
    """
    prepare_jax()
    if isinstance(case, str | Path):
        case = load_case(case)
    if not isinstance(case, Case):
        kind = type(case).__name__
        remedy = "give a Case or its folder; snakejax.estimation, .diagnosis and .design work on models"
        raise InputError(f"A case is needed, but this is a {kind}", "argument case", remedy)
    inspection = inspected(case, as_recorded)
    for f in in_brief(inspection.findings):
        run = f"run {f.run}: " if f.run is not None else ""
        warnings.warn(f"{case.name}: {run}{f.what}: {f.done}", stacklevel=4)
    return inspection.require_sound().case


def sound_subject(case: Case | Preset | Model | Path | str, as_recorded: bool = False) -> Case | Preset | Model:
    """`sound_case`, or a `Preset`, also by its name, or a `Model` as it is."""
    prepare_jax()
    if isinstance(case, str) and case in PRESETS and not Path(case).exists():
        return preset(case)
    return case if isinstance(case, Preset | Model) else sound_case(case, as_recorded)


def takes(options: type, **defaults: Any) -> Callable[[F], F]:
    """Give a function of `**options` the signature with their names; other names are refused.

    `defaults`: those that are not None.
    """

    def decorated(function: F) -> F:
        own = inspect.signature(function)
        before = [p for p in own.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        further = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=defaults.get(name), annotation=annotation)
            for name, annotation in options.__annotations__.items()
        ]
        signature = own.replace(parameters=[*before, *further])

        @functools.wraps(function)
        def called(*args: Any, **kwargs: Any) -> Any:
            for name in kwargs.keys() - signature.parameters.keys():
                arguments = list(signature.parameters)
                raise TypeError(f"{function.__name__}() has no argument `{name}`: {instead_of(name, arguments)}")
            signature.bind(*args, **kwargs)
            return function(*args, **kwargs)

        called.__signature__ = signature  # type: ignore[attr-defined]
        return called  # type: ignore[return-value]

    return decorated
