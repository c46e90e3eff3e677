"""What keeps an acceptance from being met however often one measures: who hides it, and what would help."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.calibration.poses.enough_poses import AcceptanceGap, AcceptanceLimits, acceptance_gaps
from cellcal.calibration.poses.measurement_prediction import (
    MeasurementPrediction,
    TestPoses,
    predict_accuracy,
)

_ENDLESS = 1e6  # repetitions of every candidate
_CURES = {
    "wire": "use a wire with a better certificate, or measure a length standard with it",
    "anchor": "measure with the wire's exit at a second place as well",
    "base": "record where the device stands in the robot's base",
    "tool": "use a target farther from the flange's axis, or one whose place is measured",
    "gravity": "measure postures in which gravity pulls the joint both ways",
}
_OTHER = "use a device that sees more than this one, or take the arm's geometry as known"


@dataclass(frozen=True, slots=True)
class Shortfall:
    """A limit that these postures and this device never keep."""

    what: str
    unit: str
    least: float  # after endless measuring, one standard deviation
    allowed: float
    hidden_behind: str  # the parameter whose knowledge would help most
    cure: str

    @property
    def shortfall_text(self) -> str:
        """Say it."""
        scale, unit = (1e3, "mm") if self.unit == "m" else (float(np.degrees(1.0)), "deg")
        return make_message(
            "not reachable with this set-up: endless measuring leaves the {what} at {least:.3g} "
            "{unit} (k=1), {allowed:.3g} {unit} are allowed; it hides behind {hidden_behind}: {cure}",
            what=self.what,
            least=self.least * scale,
            unit=unit,
            allowed=self.allowed * scale,
            hidden_behind=self.hidden_behind,
            cure=self.cure,
        )


def find_shortfall(
    prediction: MeasurementPrediction, candidates_rad: Array, acceptance: AcceptanceLimits, tests: TestPoses
) -> Shortfall | None:
    """Return what no number of readings at these candidates would bring, worst first; None if all is reachable.

    Parameters
    ----------
    prediction : MeasurementPrediction
        What is known.
    candidates_rad : (C, n)
        Postures that can be measured [rad].
    acceptance : Acceptance
        Limits with their margin.
    tests : TestPoses
        Where the target's place counts.
    """
    endless = prediction.with_measured(candidates_rad, times=_ENDLESS)
    missing = acceptance_gaps(predict_accuracy(endless, tests), acceptance)
    if not missing:
        return None
    gap = missing[0]
    behind, role = _hidden_behind(endless, gap, tests)
    return Shortfall(gap.what, gap.unit, gap.predicted, gap.allowed, behind, _CURES.get(role, _OTHER))


def _hidden_behind(endless: MeasurementPrediction, gap: AcceptanceGap, tests: TestPoses) -> tuple[str, str]:
    """Return the parameter, other than the one in question, whose knowledge would take away most of the variance."""
    covariance = np.linalg.inv(endless.information)
    parameters = endless.layout.parameters
    names = [parameter.name for parameter in parameters]
    if gap.what in names:
        own = names.index(gap.what)
        shares = covariance[own] ** 2 / np.diag(covariance)
        shares[own] = 0.0
    else:
        rows = tests.tool_point_rows(endless).reshape(len(names), -1)
        shares = ((covariance @ rows) ** 2).sum(axis=1) / np.diag(covariance)
    worst = int(np.argmax(shares))
    return names[worst], parameters[worst].role
