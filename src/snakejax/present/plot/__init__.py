"""Figures for papers, with matplotlib and no display. Each function returns the figure; `save` writes it.

| function | shows |
|---|---|
| `paths` | measured and modelled paths, on equal axes, with marks for the heading |
| `residuals` | measured less modelled over time, lost frames shaded |
| `tyre` | the lateral force against slip, with its band, and the forces reconstructed from the recordings |
| `fall` | one path before and after, and the error after each step |
| `waterfall` | the error after each step |
| `ranking` | the remaining error with each candidate effect, and its significance |
| `confusability` | which candidates the runs cannot distinguish |
| `missing` | the missing force, and its dependence |
| `prediction` | the errors of predictions over the horizon, for each group and model |
| `sweep` | k_s against a parameter with its polynomial, or maps over two |
| `tuned` | a gait before and after tuning: path, joints within their limits, spread over samples |
| `designed` | a run designed to distinguish two effects, or to determine the tyre |
| `vehicle` | the vehicle at one time, measured and modelled |
| `snapshots` | a path with the vehicle at some times |
| `animate` | the moving vehicle, as GIF or MP4 |

The measurement is grey, the base model blue; each step has one colour and dash in every figure.
"""

from .animation import animate as animate
from .animation import require_film as require_film
from .animation import snapshots as snapshots
from .animation import vehicle as vehicle
from .candidates import confusability as confusability
from .candidates import ranking as ranking
from .design import designed as designed
from .design import tuned as tuned
from .forces import missing as missing
from .forces import tyre as tyre
from .misfit import fall as fall
from .misfit import waterfall as waterfall
from .paths import gaps as gaps
from .paths import paths as paths
from .paths import residuals as residuals
from .prediction import prediction as prediction
from .save import save as save
from .sweep import sweep as sweep
