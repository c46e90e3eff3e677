"""The result of a fixture alignment: whether the points fit the drawing, how well it is known, and its verdict."""

import math
from dataclasses import dataclass

from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.points.fixture import PlacedPoints
from cellcal.calibration.wires.network_fit import WireNetwork
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.run import RefusalError
from cellcal.procedures.survey.shared_fixture import BasePrediction
from cellcal.procedures.survey.survey import SurveyRules
from cellcal.procedures.survey.survey_choice import saving_text
from cellcal.procedures.verdict import (
    Characteristic,
    ProcedureVerdict,
    SetAside,
    chi_square_rule,
    known_within,
    state_fact,
    state_figure,
)


@dataclass(frozen=True, slots=True)
class AlignmentResult:
    """The alignment, how well the points found fit the drawing, and what it took."""

    alignment: Alignment
    placed: PlacedPoints
    network: WireNetwork
    captures: int
    fixed_plan_captures: int | None  # evenly drawn poses for the same U; None: more than were drawn
    limits: FrameLimits
    base: BasePrediction | None = None  # None where it was not asked for
    set_aside: tuple[SetAside, ...] = ()

    @property
    def saving_text(self) -> str:
        """The effort that choosing the poses saved, in words."""
        return saving_text(self.captures, self.fixed_plan_captures)


def wrong_shape_error(result: AlignmentResult) -> RefusalError | None:
    """Return the refusal of points that do not have the shape of the drawing, None where they have it."""
    placed = result.placed
    if placed.is_consistent():
        return None
    return RefusalError(
        make_message(
            "alignment points {i} and {j} were found {worst_gap_mm:.2f} mm {detail} each other than "
            "on the drawing ({worst_deviation:.1f} deviations)",
            **placed.worst_gap_arguments(),
        ),
        code="procedure.wrong_shape",
        remedy="See that the adaptor sat on the points in the order of the drawing, and that the drawing is of this "
        "fixture; then start a new run.",
        evidence=result,
    )


def uncertain_error(result: AlignmentResult, bases: FrameLimits | None) -> RefusalError | None:
    """Return the refusal of a fixture, or a base seen through it, that is not known well enough; else None."""
    figures: list[tuple[str, PlacedPoints | BasePrediction, FrameLimits]]
    figures = [("the fixture", result.placed, result.limits)]
    if result.base is not None and bases is not None:
        figures.append(("a base through the fixture", result.base, bases))
    missed = [
        make_message(
            "{what} is known within {origin_u_mm:.3f} mm and {angle_u_deg:.4f} deg (k=2); {origin_mm:.3f} mm and "
            "{angle_deg:.4f} deg are asked for",
            what=what,
            origin_u_mm=found.origin_u_m * 1e3,
            angle_u_deg=math.degrees(found.angle_u_rad),
            origin_mm=limits.origin_m * 1e3,
            angle_deg=math.degrees(limits.angle_rad),
        )
        for what, found, limits in figures
        if found.origin_u_m > limits.origin_m or found.angle_u_rad > limits.angle_rad
    ]
    if not missed:
        return None
    return RefusalError(
        make_message(
            "after {captures} captures {missed}", captures=result.captures, missed=join_messages("; ", missed)
        ),
        code="procedure.undecided",
        remedy="Use more alignment points (six, spread wide and not in one plane, usually reach 0.15 mm where four "
        "reach 0.24 mm), a mastering record with more poses, more readings (samples) and captures (max_captures), "
        "or a wire with a better certificate (scale_sigma).",
        evidence=result,
    )


def alignment_instruction(result: AlignmentResult) -> Instruction:
    """Return what a person is to accept: where the fixture stands and how well it is known."""
    placed = result.placed
    x, y, z = (value * 1e3 for value in placed.outer_inner.position_m)
    return Instruction(
        "accept_alignment",
        make_message(
            "{fixture}: origin x {x:.2f}, y {y:.2f}, z {z:.2f} mm from the base, within "
            "{origin_u_mm:.3f} mm and {angle_u_deg:.4f} deg (k=2); the points fit the drawing within "
            "{rms_mm:.3f} mm RMS. {entry_text}.",
            fixture=result.alignment.fixture,
            x=x,
            y=y,
            z=z,
            origin_u_mm=placed.origin_u_m * 1000.0,
            angle_u_deg=math.degrees(placed.angle_u_rad),
            rms_mm=placed.rms_m * 1000.0,
            entry_text=result.saving_text,
        ),
    )


def judge_alignment(
    result: AlignmentResult, bases: FrameLimits | None, rules: SurveyRules
) -> ProcedureVerdict:
    """Return the verdict on an alignment; ``bases`` are the limits of other robots' bases, if any."""
    placed, limits = result.placed, result.limits
    return ProcedureVerdict(
        characteristics=(
            known_within("fixture's origin", "m", u=placed.origin_u_m / 2.0, limit=limits.origin_m),
            known_within("fixture's angle", "rad", u=placed.angle_u_rad / 2.0, limit=limits.angle_rad),
            state_fact(
                "shape of the points",
                placed.is_consistent(),
                chi_square_rule("chi square of the points found against the drawing, 99.9 %"),
                found=placed.chi_square,
                limit=placed.most_chi_square,
            ),
            *_base_figures(result, bases),
            state_figure("residual of the points", placed.rms_m, "m"),
            state_figure("residual of the lengths", result.network.residual_rms_m, "m"),
        ),
        limits_from="limits of the settings",
        remarks=(result.saving_text,),
        set_aside=result.set_aside,
        not_verified=(
            make_message(
                "the wire's scale is taken from its certificate: {scale_sigma:.3f} mm per metre (k=1)",
                scale_sigma=rules.scale_sigma * 1000.0,
            ),
            make_message(
                "drawing and seat of a point are taken as {point_sigma_mm:.3f} mm (k=1)",
                point_sigma_mm=rules.point_sigma_m * 1000.0,
            ),
        ),
    )


def _base_figures(result: AlignmentResult, limits: FrameLimits | None) -> tuple[Characteristic, ...]:
    base = result.base
    if base is None or limits is None:
        return ()
    what = (
        make_message("base of {robot_name}", robot_name=base.seen)
        if base.seen
        else "base of a robot that becomes aligned as well"
    )
    return (
        known_within(
            make_message("{what}, origin", what=what), "m", u=base.origin_u_m / 2.0, limit=limits.origin_m
        ),
        known_within(
            make_message("{what}, angle", what=what), "rad", u=base.angle_u_rad / 2.0, limit=limits.angle_rad
        ),
    )
