"""What a page is shown of an arm's parameters: those that are known, and those that are not, by their cures."""

from collections.abc import Iterable, Sequence

from cellcal.calibration.identification.identifiability import NotIdentified
from cellcal.service.engineering.identification.identify_findings import IdentifiedRow, unknown_by_cure


def findings_document(
    identified: Sequence[IdentifiedRow], ripple_count: int, not_identified: Iterable[NotIdentified]
) -> dict[str, object]:
    """Return the known parameters with their deviations, how many of ripple beside them, and the unknown ones."""
    return {
        "parameters": [
            {
                "name": row.name,
                "unit": row.unit,
                "deviation": row.deviation,
                "standard_uncertainty": row.sigma,
            }
            for row in identified
        ],
        "ripple_count": ripple_count,
        "unknown": [
            {"cure": cure, "hidden": [{"names": names, "behind": one} for one, names in behind.items()]}
            for cure, behind in unknown_by_cure(not_identified).items()
        ],
    }
