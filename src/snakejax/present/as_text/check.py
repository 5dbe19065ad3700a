"""The contents of a case and its issues as text."""

from collections.abc import Sequence

from snakejax.recording.case_check import Issue, _readings, _which, run_summary
from snakejax.recording.quality import in_brief
from snakejax.recording.run import Case

MOST_RUNS = 30
"""The runs listed on a terminal; the JSON has all."""


def check_text(case: Case, issues: Sequence[Issue]) -> str:
    """The runs of `case` and its `issues` as text."""
    summaries = [run_summary(run) for run in case.runs]
    width = max(len(summary.run) for summary in summaries)
    train, heldout = len(case.having("train")), len(case.having("heldout"))
    lines = [f"{case.name}: {case.title}", f"{train} train and {heldout} heldout runs, skid {case.constraint}", ""]
    lines += [f"{'run':{width}}  {'role':7}  {'duration':>9}  {'rate':>9}  {'samples':>7}  {'lost':>5}"]
    lines += [
        f"{s.run:{width}}  {s.role:7}  {s.duration:7.2f} s  {s.rate:6.1f} Hz  {s.samples:7d}  {s.lost:5d}"
        for s in summaries[:MOST_RUNS]
    ]
    lines += [f"... and {len(summaries) - MOST_RUNS} more runs"] if len(summaries) > MOST_RUNS else []
    lines += [f"{note} ({_which(names, len(summaries))})" for note, names in _readings(case).items()]
    lines += ["", "issues:" if issues else "no issues"]
    for issue in in_brief(issues):
        lines.append(f"  {'? ' if issue.severity == 'doubtful' else '  '}{issue.run or 'the case'}: {issue.what}")
        lines += [f"      {issue.remedy}"] if issue.remedy else []
    return "\n".join(lines)
