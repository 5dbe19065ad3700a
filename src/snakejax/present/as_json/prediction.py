"""The errors of predictions as JSON."""

from snakejax.dynamics.model import Model
from snakejax.estimation.prediction import Predictions

from .provenance import heading_json
from .values import Json, clean


def prediction_json(
    name: str, model: Model, groups: Predictions, times: tuple[float, tuple[float, ...]], provenance: Json
) -> Json:
    """The result of `snakejax predict`; `times`: lead and horizons [s]. An error that is not finite is null."""
    lead, horizons = times
    return clean(
        {
            **heading_json(name, model, None, provenance),
            "lead_s": lead,
            "horizons_s": horizons,
            "groups": {
                group: {
                    model_name: {
                        horizon: {
                            "position_m": error.position,
                            "heading_rad": error.heading,
                            "position_90_m": error.position_90,
                            "heading_90_rad": error.heading_90,
                            "windows": error.windows,
                        }
                        for horizon, error in by_horizon.items()
                    }
                    for model_name, by_horizon in models.items()
                }
                for group, models in groups.items()
            },
        }
    )
