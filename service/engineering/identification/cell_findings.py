"""What the readings of a cell determine of its arms and devices, as the terminal and the pages list it."""

from cellcal.service.engineering.identification.cell_identify import IdentifiedCellReport
from cellcal.service.engineering.identification.identify_findings import LEARNT, IdentifiedRow

_DH = ("offset", "d", "a", "alpha", "beta")


def identified_numbers(report: IdentifiedCellReport) -> tuple[list[IdentifiedRow], int]:
    """Return what is known, geometry as a DH table has it; and how many coefficients of ripple."""
    prior = {item.name: item.prior for item in report.parameters}
    rows: list[IdentifiedRow] = []
    in_tables: set[str] = set()
    for arm in report.arms:
        if arm.dh is None:
            continue
        mark = f"{arm.name} " if len(report.arms) > 1 else ""
        # As four numbers a joint: beside its beta an offset as fitted means nothing.
        in_tables |= {
            f"{mark}J{i + 1} {what}" for i in range(arm.fit.state.nominal.axis_count) for what in _DH
        }
        rows += [
            IdentifiedRow(mark + entry.name, entry.value - entry.nominal, entry.sigma, entry.unit)
            for entry in arm.dh.entries
            if (name := mark + entry.name) in prior and entry.sigma < LEARNT * prior[name]
        ]
    rest = [p for p in report.parameters if p.name not in in_tables and p.sigma < LEARNT * p.prior]
    ripple_count = sum(" ripple " in p.name for p in rest)
    rows += [IdentifiedRow(p.name, p.value, p.sigma, p.unit) for p in rest if " ripple " not in p.name]
    return rows, ripple_count
