"""What a judged run looks like on a page: points of a fit, errors at poses that were not fitted, a map."""

from dataclasses import dataclass

from cellcal.calibration.errors import CellError

Triple = tuple[float, float, float]


class ReviewError(CellError):
    """Something was asked of a run that it cannot tell."""

    code = "review"


@dataclass(frozen=True, slots=True)
class ReviewPoint:
    """One reading of a fit: what it misses the fit by, whether it took part, and whether it looks like it should."""

    step: str
    used: bool
    outlier: bool
    residual_m: float  # of a length with its sign, measured minus computed; else a distance
    deviations: float  # in standard deviations of what it may be
    reason: str  # why the run itself did not use it


@dataclass(frozen=True, slots=True)
class ErrorSpread:
    """Errors of several readings as three figures, and how surely the RMS is known."""

    mean_m: float
    rms_m: float
    max_m: float
    u_m: float  # of the RMS, k = 2


@dataclass(frozen=True, slots=True)
class CheckPoint:
    """One pose that took no part in a fit."""

    step: str
    before_m: float
    after_m: float


@dataclass(frozen=True, slots=True)
class Validation:
    """The same readings, none of them fitted, before and after."""

    before: ErrorSpread
    after: ErrorSpread
    points: tuple[CheckPoint, ...]


@dataclass(frozen=True, slots=True)
class WorkPlace:
    """One posture that stands for the work, and where the target is then."""

    in_base_m: Triple
    error_m: (
        float  # of the nominal arm, as the fit has it; what a frame set over the work takes away left out
    )
    u_m: float  # how surely the fitted arm is known there, k = 2


@dataclass(frozen=True, slots=True)
class ReviewValue:
    """One figure of what was fitted, with these points and as it was signed."""

    name: str
    unit: str
    value: float
    signed: float


@dataclass(frozen=True, slots=True)
class Review:
    """A run, judged as it was signed, or with another choice of readings: that one is a what-if and nothing more."""

    run_id: str
    along: (
        str  # wire: lengths, with a sign; distances: space, of a target; touch, of a tip; place, of a point
    )
    signed: bool
    least: int  # readings that such a fit takes
    points: tuple[ReviewPoint, ...] = ()
    rms_m: float | None = None  # of the used points
    max_m: float | None = None
    u_m: float | None = None  # of what the run is about, k = 2 or 95 % …
    u_of: str = "target"  # … over the work; or the tip, the origin, the hook
    signed_rms_m: float | None = None
    signed_u_m: float | None = None
    values: tuple[ReviewValue, ...] = ()
    validation: Validation | None = None
    places: tuple[WorkPlace, ...] = ()


@dataclass(frozen=True, slots=True)
class Displacement:
    """The largest displacement of the tip over postures drawn evenly between the joint limits."""

    most_m: float
    mean_m: float
    postures: int
    tip_in_flange_m: tuple[float, float, float]  # of the newest tool that was found; zeros: the flange
    left_out: tuple[str, ...]  # parameters that differ and that a rigid arm has no place for


@dataclass(frozen=True, slots=True)
class TipUncertainty:
    """An ellipsoid about the tip; without parts nothing is known."""

    joints_rad: tuple[float, ...]
    tip_in_flange_m: tuple[float, float, float]
    parts: tuple[str, ...]  # of ``tool`` and ``arm``, those that were measured
    semi_axes_m: tuple[float, ...] = ()  # k = 2, longest first
    base_ellipsoid: tuple[
        float, ...
    ] = ()  # (3, 3) row by row: its axes as columns, right-handed, in the base
    runs: tuple[str, ...] = ()  # where the parts come from
