"""Verdicts of an identification: held-out errors against a limit, joint offsets against theirs."""

from dataclasses import dataclass

from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.cross_validation import rmse_uncertainty
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.offset_acceptance import OffsetAcceptance, accept_offsets
from cellcal.calibration.uncertainty import Decision, Verdict, decide_conformity


@dataclass(frozen=True, slots=True)
class IdentificationLimits:
    """The limits that a result must keep to be accepted; None is not asked."""

    error_m: float | None = None  # RMSE of rows that were not fitted
    offset_sigma_rad: float | None = None
    offsets: tuple[str, ...] = ()  # that count; none means every free one


@dataclass(frozen=True, slots=True)
class IdentificationVerdicts:
    """The verdicts on the limits; None where there was none."""

    error: Decision | None = None
    judged: str = ""  # which rows
    offsets: OffsetAcceptance | None = None

    @property
    def is_proved(self) -> bool:
        """Whether every limit that was set is proved to be kept."""
        every = [item.verdict for item in (self.error, self.offsets) if item is not None]
        return all(verdict is Verdict.PASS for verdict in every)


def judge_limits(
    limits: IdentificationLimits, found: Identification, errors_m: Array, groups: Rows, judged: str
) -> IdentificationVerdicts:
    """Judge errors (N,) of rows that were not fitted, and the offsets.

    Raises
    ------
    CalibrationError
        An offset that was not fitted, or a limit that is none.
    """
    offsets = None
    if limits.offset_sigma_rad is not None:
        offsets = accept_offsets(found.robust, limits.offset_sigma_rad, limits.offsets)
    if limits.error_m is None:
        return IdentificationVerdicts(offsets=offsets)
    value, sigma, freedom = rmse_uncertainty(errors_m, groups)
    return IdentificationVerdicts(
        decide_conformity(value, sigma, limits.error_m, degrees_of_freedom=freedom), judged, offsets
    )
