"""The refusal of measurements that do not fit their robot, and the causes that it names."""

from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.identification.misfit_ranking import MisfitCandidate
from cellcal.calibration.message import join_messages, make_message


class MisfitError(CalibrationError):
    """Measurements that do not fit the robot, with the cause that explains them if one is known."""

    code = "calibration.misfit"

    def __init__(self, message: str, *, remedy: str = "", causes: tuple["MisfitCause", ...] = ()) -> None:
        super().__init__(message, remedy=remedy)
        self.causes = causes


@dataclass(frozen=True, slots=True)
class MisfitCause:
    """One explanation of a misfit."""

    kinds: tuple[str, ...]  # unit | angle unit | mirror | coupling | sign | home | order | rows | model
    says: str
    cure: str
    remaining_m: float  # RMS of the rows, with this cause


@dataclass(frozen=True, slots=True)
class MisfitScore:
    """The quality of a fit, and how far the zeros of the inner joints then are from where they should be."""

    score_m: float
    offsets_rad: tuple[float, ...] = ()
    sigma_rad: tuple[float, ...] = ()


def cure_by_column(column: str) -> str:
    """Return the cure for rows of several targets that a column tells apart."""
    return make_message(
        "Column {column!r} tells several targets or tools apart: keep the rows of one in the file, or describe all "
        "of them in a layout (`--layout`, examples in `deploy/layouts/`).",
        column=column,
    )


def describe_cause(candidate: MisfitCandidate, fitted: MisfitScore) -> MisfitCause:
    """Return a candidate as the cause that it stands for, with what remains of the misfit."""
    says, cures = (
        [*candidate.cause_texts, candidate.reading.says],
        [*candidate.cure_texts, candidate.reading.cure],
    )
    return MisfitCause(
        candidate.kinds,
        ", and ".join(word for word in says if word),
        join_messages(" ", filter(None, cures)),
        fitted.score_m,
    )


def say_column_apart(column: str, rows_down: int) -> str:
    """Return that a column stands so many rows from the others, negative: up."""
    if rows_down > 0:
        return make_message(
            "{column} stands {count} rows too far down in the file", column=column, count=rows_down
        )
    return make_message(
        "{column} stands {count} rows too far up in the file", column=column, count=-rows_down
    )


def cure_or_others(cure: str, others: Sequence[MisfitCause]) -> str:
    """Return a cure, and those of the causes that fit as well."""
    cures = [cure]
    for cause in others:
        cures += [make_message("It fits as well that {says}.", says=cause.says), cause.cure]
    return join_messages(" ", cures)


def misfit_error(
    model: RobotModel, left_m: float, motion_m: float, causes: tuple[MisfitCause, ...]
) -> MisfitError:
    """Return the refusal of rows that only the causes explain, the likeliest first; lengths [m]."""
    first, *rest = causes
    return MisfitError(
        make_message(
            "the measurements do not fit {model_name}: {left_mm:.1f} mm remain of a motion of "
            "{motion_mm:.0f} mm; only {remaining_mm:.2f} mm remain if {says}.",
            model_name=model.label,
            left_mm=left_m * 1000.0,
            motion_mm=motion_m * 1000.0,
            remaining_mm=first.remaining_m * 1000.0,
            says=first.says,
        ),
        remedy=make_message("{cure} Nothing was stored.", cure=cure_or_others(first.cure, rest)),
        causes=causes,
    )


def one_target_error(model: RobotModel, before_m: float, cause: MisfitCause, remedy: str) -> MisfitError:
    """Return the refusal of rows that were taken as of one target, and leave so much [m] without the cause."""
    return MisfitError(
        make_message(
            "the measurements do not fit {model_name} with one target: {left_mm:.2f} mm remain, and "
            "{remaining_mm:.2f} mm if {says}.",
            model_name=model.label,
            left_mm=before_m * 1000.0,
            remaining_mm=cause.remaining_m * 1000.0,
            says=cause.says,
        ),
        remedy=remedy,
        causes=(cause,),
    )
