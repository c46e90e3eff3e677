"""Robots' bases seen from one another: what is asked for and found, its verdict and its words."""

import math
from dataclasses import dataclass

from cellcal.calibration.message import join_messages, make_message
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.points.fixture import BaseToBase
from cellcal.calibration.uncertainty import chi_square_limit
from cellcal.drivers.interfaces import Counts, Instruction
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.run import RefusalError
from cellcal.procedures.verdict import (
    NOTHING_MEASURED,
    ProcedureVerdict,
    chi_square_rule,
    known_within,
    state_fact,
    state_figure,
)


@dataclass(frozen=True, slots=True)
class SeenBase:
    """One robot's base seen from the reference robot's."""

    robot_serial: str
    pose: BaseToBase  # ``other_base_base``: other is the reference


@dataclass(frozen=True, slots=True)
class BasesResult:
    """All bases seen from the reference robot's, with the alignments they come from."""

    fixture: str
    reference_serial: str
    bases: tuple[SeenBase, ...]
    alignments: tuple[Alignment, ...]  # the reference's first
    jointly: bool = False  # in one fit; False: chained one by one
    chi_square: float = 0.0  # of the points that all robots found, against one drawing
    degrees_of_freedom: int = 0


@dataclass(frozen=True, slots=True)
class AlignmentsFound:
    """The stored alignments of a fixture, and the mastering of the robot that is connected."""

    alignments: tuple[Alignment, ...]
    connected_serial: str
    counts_at_zero: Counts  # of the connected robot; empty where it keeps none


def _is_same_shape(result: BasesResult) -> bool:
    freedom = result.degrees_of_freedom
    return freedom == 0 or result.chi_square <= chi_square_limit(freedom)


def bases_shape_error(result: BasesResult) -> RefusalError | None:
    """Return the refusal of a fixture whose shape the robots found differently, or None."""
    if _is_same_shape(result):
        return None
    return RefusalError(
        make_message(
            "the robots did not find one shape of {fixture}: chi square {chi_square:.0f}, "
            "{degrees_of_freedom} degrees of freedom",
            fixture=result.fixture,
            chi_square=result.chi_square,
            degrees_of_freedom=result.degrees_of_freedom,
        ),
        code="procedure.wrong_shape",
        remedy="See that fixture, adaptor and wire are whole and the same for all; then align the robots again.",
        evidence=result,
    )


def uncertain_bases_error(result: BasesResult, limits: FrameLimits) -> RefusalError | None:
    """Return the refusal of the first base that is known worse than asked for, or None."""
    for base in result.bases:
        if base.pose.origin_u_m > limits.origin_m or base.pose.angle_u_rad > limits.angle_rad:
            return RefusalError(
                make_message(
                    "the base of {robot_serial} is known within {origin_u_mm:.3f} mm and {angle_u_deg:.4f} "
                    "deg (k=2); {origin_mm:.3f} mm and {angle_deg:.4f} deg are asked for",
                    robot_serial=base.robot_serial,
                    origin_u_mm=base.pose.origin_u_m * 1000.0,
                    angle_u_deg=math.degrees(base.pose.angle_u_rad),
                    origin_mm=limits.origin_m * 1000.0,
                    angle_deg=math.degrees(limits.angle_rad),
                ),
                code="procedure.undecided",
                remedy="Align the robots again and go on for the bases (fixture_alignment, bases): first with "
                "more alignment points (ten, spread wide), then with more readings (samples) and captures.",
                evidence=result,
            )
    return None


def bases_instruction(result: BasesResult) -> Instruction:
    """Return the page that shows where the bases stand, with U (k = 2)."""
    lines = []
    for base in result.bases:
        pose = base.pose
        x, y, z = (value * 1e3 for value in pose.other_base_base.position_m)
        ux, uy, uz = (value * 1e3 for value in pose.origin_axes_u_m)
        lines.append(
            make_message(
                "{robot_serial} stands at x {x:.2f}, y {y:.2f}, z {z:.2f} mm from {reference_serial}, U (k=2) x "
                "{ux:.3f}, y {uy:.3f}, z {uz:.3f} mm, in space {space_u_mm:.3f} mm (95 %), "
                "angle {angle_u_deg:.4f} deg",
                robot_serial=base.robot_serial,
                x=x,
                y=y,
                z=z,
                reference_serial=result.reference_serial,
                ux=ux,
                uy=uy,
                uz=uz,
                space_u_mm=pose.origin_space_u_m * 1e3,
                angle_u_deg=math.degrees(pose.angle_u_rad),
            )
        )
    return Instruction(
        "accept_bases",
        make_message("Through {fixture}: {lines}.", fixture=result.fixture, lines=join_messages("; ", lines)),
    )


def judge_bases(result: BasesResult, limits: FrameLimits) -> ProcedureVerdict:
    """Return the figures of all bases against the limits of the settings."""
    rule = chi_square_rule("chi square of the points that all robots found, against one drawing, 99.9 %")
    freedom = result.degrees_of_freedom
    most = chi_square_limit(freedom) if freedom else None
    shape = state_fact(
        "one shape of the fixture", _is_same_shape(result), rule, found=result.chi_square, limit=most
    )
    figures = [
        figure
        for base in result.bases
        for figure in (
            known_within(
                make_message("origin of {robot_serial}", robot_serial=base.robot_serial),
                "m",
                u=base.pose.origin_u_m / 2.0,
                limit=limits.origin_m,
            ),
            known_within(
                make_message("angle of {robot_serial}", robot_serial=base.robot_serial),
                "rad",
                u=base.pose.angle_u_rad / 2.0,
                limit=limits.angle_rad,
            ),
        )
    ]
    in_space = [
        state_figure(
            make_message("origin of {robot_serial} in space", robot_serial=base.robot_serial),
            base.pose.origin_space_u_m,
            "m",
            rule="95 % ball",
        )
        for base in result.bases
    ]
    along = [
        state_figure(
            make_message("origin of {robot_serial} along {axis}", robot_serial=base.robot_serial, axis=axis),
            u_m,
            "m",
            rule="U (k = 2)",
        )
        for base in result.bases
        for axis, u_m in zip("xyz", base.pose.origin_axes_u_m, strict=True)
    ]
    return ProcedureVerdict(
        characteristics=(*figures, *((shape,) if result.jointly else ()), *along, *in_space),
        limits_from="limits of the settings",
        not_verified=(
            "that the fixture stood still between the alignments: the technician's word",
            "the mastering of robots that are not connected",
        ),
        remarks=(NOTHING_MEASURED,),
    )
