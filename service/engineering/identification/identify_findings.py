"""What an identification says of the arm: the parameters that it determines, and those that stay open, by cure."""

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from cellcal.calibration.identification.identifiability import NotIdentified
    from cellcal.service.engineering.identification.identify import IdentifyReport

LEARNT = 0.5  # of the prior deviation
_MEASURE_WIDER = "these postures hardly show them: measure over a wider range of these joints"
_NO_CURE_NEEDED = "none needed"
_GEOMETRY = {"offset", "d", "a", "alpha", "beta"}


class IdentifiedRow(NamedTuple):
    """One parameter that the measurements determine: its deviation from nominal, in rad, m, rad/m or 1."""

    name: str
    deviation: float
    sigma: float
    unit: str


def identified_rows(report: "IdentifyReport") -> tuple[list[IdentifiedRow], int]:
    """Return what is known, geometry as a DH table has it; and how many coefficients of ripple."""
    determined = [p for p in report.parameters if not p.held and p.sigma < LEARNT * p.prior]
    prior = {p.name: p.prior for p in report.parameters if not p.held}
    table = {} if report.dh is None else {entry.name: entry for entry in report.dh.entries}
    shown = [
        IdentifiedRow(name, entry.value - entry.nominal, entry.sigma, entry.unit)
        for name, entry in table.items()
        if name in prior and entry.sigma < LEARNT * prior[name]
    ]
    geometry = _GEOMETRY if table else set()
    rest = [p for p in determined if p.name.split()[-1] not in geometry]
    shown += [IdentifiedRow(p.name, p.value, p.sigma, p.unit) for p in rest if " ripple " not in p.name]
    return shown, sum(" ripple " in p.name for p in rest)


def unknown_of(report: "IdentifyReport") -> "list[NotIdentified]":
    """Return what is not identified and not among the rows that are."""
    determined = {row.name for row in identified_rows(report)[0]}
    return [item for item in report.identification.not_identified if item.parameter not in determined]


def unknown_by_cure(items: "Iterable[NotIdentified]") -> dict[str, dict[str, list[str]]]:
    """Return names by cure and by what they are hidden behind (empty: nothing); equal answers need no cure."""
    together: dict[str, dict[str, list[str]]] = {}
    for item in items:
        if not item.cure.startswith(_NO_CURE_NEEDED):
            alone = not item.partner and re.match(r"(.* )?J\d+ ", item.parameter)
            behind = together.setdefault(_MEASURE_WIDER if alone else item.cure, {})
            behind.setdefault(item.partner, []).append(item.parameter)
    return together
