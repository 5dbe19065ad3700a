"""Results for other programs: xarray and pandas, ArviZ, CommonRoad's parameter files, and C.

| function | gives |
|---|---|
| `runs_dataset`, `runs_dataframe` | recorded runs as an xarray Dataset or a pandas DataFrame |
| `residuals_dataset`, `residuals_dataframe` | measured and modelled poses of a fitted model, and the residual |
| `inference_data` | samples from the posterior of a fit, for ArviZ |
| `commonroad_yaml` | a model in the form of a CommonRoad parameter file |
| `c_function` | the rates of a model as a function in C |

The tables of results have `to_dataframe()` and `to_xarray()` themselves.
"""

from .c_code import c_function as c_function
from .commonroad import commonroad_yaml as commonroad_yaml
from .datasets import residuals_dataframe as residuals_dataframe
from .datasets import residuals_dataset as residuals_dataset
from .datasets import runs_dataframe as runs_dataframe
from .datasets import runs_dataset as runs_dataset
from .inference import inference_data as inference_data
