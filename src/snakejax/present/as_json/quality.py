"""The findings about recordings as JSON."""

from snakejax.recording.quality import Inspection

from .values import Json


def quality_json(inspection: Inspection) -> Json:
    """The findings, the actions taken, and the number of masked frames of each run."""
    return {
        "as_recorded": inspection.as_recorded,
        "findings": [
            {
                "kind": f.kind,
                "run": f.run,
                "from_s": f.start,
                "to_s": f.end,
                "size": f.size,
                "unit": f.unit,
                "what": f.what,
                "remedy": f.remedy,
                "action": f.action,
                "applied": f.applied,
                "severity": f.severity,
            }
            for f in inspection.findings
        ],
        "masked": inspection.masked,
    }
