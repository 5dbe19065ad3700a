"""The paper's claims, one by one, against this model: Salman, Dear, Babikian, Shammas, Choset, CDC 2016.

    python fit/paper.py [FOLDER] [RECORDINGS ...]

writes `paper.md` and its figures into FOLDER (default `docs`). The claims are numbered P1 to P14; each gets our number
and a verdict by a criterion that stands beside it ("close": by a wider limit, or but for one case). The paper's own
recordings are not public, so that Figs. 11 and 12 have counterparts on recordings of other boards: RECORDINGS, case
folders, by default those in `data`.
"""

import sys
from pathlib import Path

import snakejax as sj

sj.prepare_jax()

import numpy as np  # noqa: E402
from claims.claim import Claim  # noqa: E402
from claims.gaits import driving, turning  # noqa: E402
from claims.loads import with_payload  # noqa: E402
from claims.polynomial import polynomials  # noqa: E402
from claims.recordings import recorded  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
D = np.linspace(0.5, 10.0, 41)
LOADS, CAMBERS = np.linspace(0.5, 10.0, 11), np.linspace(0.0, 0.6, 3)
RECORDINGS = ("level-board", "tilted-floor", "spring-board")

TEXT = """# The paper's claims

*`fit/paper.py` writes this page and computes its numbers.*

The paper is Salman, Dear, Babikian, Shammas, Choset, *A physical parameter-based skidding model for the snakeboard*,
CDC 2016. Under its printed equations a board at rest does not move (see `sj.vehicles.Printed`). So the numbers below
are those of the structure `coupled`, which reproduces the rotate result of the paper. The board starts at rest and has
the controller of the paper. The structure `free` is Newton's law. The inertias of Table II add to 0.4358 kg m^2; we use
the assumption of the paper, I = m L^2 = 0.4375 kg m^2. The recordings of the paper are not public, so nobody can
compare its Figs. 11 and 12 with the original data.

{claims}

## k_s against D (counterpart of Fig. 8)

Grey points: the nearest Rayleigh board is more than 10 % of the path length away.

![k_s against D for four gaits and two structures](fig8.png)

{polynomials}

## Load and camber, Bakker's tyre

The paper did not publish this.

![Mismatch of the best Rayleigh board against load and camber](loads.png)

## Counterparts of the figures

![Gait 1 and the best Rayleigh board](fig5-6.png)

![Gait 2 and the best Rayleigh board](fig7.png)

![Heading under rotate](fig13.png)

![A recording and the best Rayleigh board](fig11-12-rayleigh.png)

![The same recording and the Pacejka board](fig11-12-pacejka.png)

## Longitudinal slip on recordings (P10)

Root mean square error of the train runs in multiples of the noise; 1 is noise. The misfit is its square.

{recordings}
"""


def main(folder: Path, recordings: list[Path]) -> list[Claim]:
    """All claims, in order."""
    folder.mkdir(parents=True, exist_ok=True)
    curve, table = polynomials(folder, D)
    seen, beside = recorded(folder, recordings)
    claims = sorted(
        [*turning(folder), *driving(), *with_payload(folder, LOADS, CAMBERS), *curve, *seen],
        key=lambda c: int(c.number[1:]),
    )
    rows = ["| | claim | our number | | criterion, and why |", "|---|---|---|---|---|"]
    rows += [f"| {c.number} | {c.claim} | {c.ours} | **{c.verdict}** | {c.why} |" for c in claims]
    text = TEXT.format(claims="\n".join(rows), polynomials=table, recordings=beside)
    (folder / "paper.md").write_text(text, encoding="utf-8")
    for claim in claims:
        print(f"{claim.number:4} {claim.verdict:11} {claim.ours}")
    return claims


if __name__ == "__main__":
    asked = [Path(argument) for argument in sys.argv[1:]]
    main(asked[0] if asked else ROOT / "docs", asked[1:] or [ROOT / "data" / name for name in RECORDINGS])
