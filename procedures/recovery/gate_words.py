"""The conditions of the gate as figures of a verdict, under names that a technician understands."""

from cellcal.calibration.mastering.turn_results import GateCheck
from cellcal.procedures.verdict import Characteristic, chance_rule, chi_square_rule, state_fact

_NAMES = {
    "success probability": "chance that the whole turns found are right",
    "ratio": "how many times further away the next best whole turns are",
    "rounding": "search and rounding find the same whole turns",
    "chi square": "misfit of the measurements (chi square)",
    "uncertainty": "uncertainty of the new zero",
    "redundancy": "largest false measurement that could stay hidden",
    "equipment": "how far the wire's points are off their record, in deviations",
    "sharpness": "how clearly a wrong turn of one motor would show, in deviations",
    "each motor alone": "how much better one motor alone would explain the measurements, in deviations",
    "verification power": "how clearly a wrong turn would show at the check poses, in deviations",
    "verification": "misfit of the check poses (chi square)",
}
_RULES = {
    "success probability": chance_rule,
    "chi square": chi_square_rule,
    "verification": chi_square_rule,
}


def state_gate_check(check: GateCheck) -> Characteristic:
    """Return a condition of the gate as a figure of a verdict; its rule says what the number means."""
    explain = _RULES.get(check.name, str)
    return state_fact(
        _NAMES.get(check.name, check.name),
        check.passed,
        explain(check.sentence),
        found=check.found,
        limit=check.limit,
        unit=check.unit,
    )
