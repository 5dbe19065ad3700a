"""Figures for papers, with matplotlib and no display. Each function returns the figure; `save` writes it.

| function | shows |
|---|---|
| `paths` | measured and modelled paths, on equal axes, with marks for the heading |
| `residuals` | measured less modelled over time, lost frames shaded |
| `tyre` | the force of the tyre against slip, with its band, and what the recordings ask of it |
| `fall` | one path before and after, and the error falling step by step |
| `waterfall` | the error falling alone |
| `ranking` | what each candidate effect would leave, and how sure it is |
| `confusability` | which candidates the runs cannot tell apart |
| `missing` | the missing force, and what it depends on |
| `sweep` | k_s against a parameter with its polynomial, or maps over two |
| `tuned` | a gait before and after tuning: path, joints within their limits, spread over draws |
| `designed` | a run designed to tell two effects apart, or to determine the tyre |
| `animate` | the moving board, as GIF or MP4 |

What is measured is grey, the base model blue, each effect of one colour and dash in every picture.
"""

from ._board import animate as animate
from ._board import board as board
from ._board import require_film as require_film
from ._candidates import confusability as confusability
from ._candidates import ranking as ranking
from ._error import fall as fall
from ._error import waterfall as waterfall
from ._force import missing as missing
from ._force import tyre as tyre
from ._gait import designed as designed
from ._gait import tuned as tuned
from ._paths import gaps as gaps
from ._paths import paths as paths
from ._paths import residuals as residuals
from ._save import save as save
from ._sweep import sweep as sweep
