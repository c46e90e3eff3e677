"""Positions of many programs side by side, and their groups by tool and frame."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.drivers.programs.barred import UNKNOWN_FRAMES
from cellcal.drivers.programs.external_settings import sets_external_axes
from cellcal.drivers.programs.file_declarations import VALUES_GIVEN
from cellcal.drivers.programs.positions import CARTESIAN, JOINTS, UNTAUGHT, ProgramFile
from cellcal.service.engineering.programs.controller_joints import NO_UNIT, as_chain, lacks_units
from cellcal.service.engineering.programs.external.point_reasons import (
    external_reasons,
    leave_lists_of_programs,
)
from cellcal.service.engineering.programs.external.point_values import PointAxes
from cellcal.service.engineering.programs.point_columns import joints_of, marked_rows, side_by_side
from cellcal.service.engineering.programs.project import Project
from cellcal.service.engineering.programs.project_pulses import MISSING, PULSES
from cellcal.service.engineering.programs.starting_postures import StartingPostures

Rows = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ProgramPoints:
    """N positions of some programs, one after the other."""

    programs: tuple[ProgramFile, ...]
    of: Rows  # (N,) whose
    row: Rows  # (N,) of its positions
    cartesian: NDArray[np.bool_]
    frame_tip: Array  # (N, 4, 4)
    joints: Array  # (N, n)
    texts: tuple[str, ...]  # configurations
    tools: tuple[str | None, ...]
    user_frames: tuple[str | None, ...]
    stays: NDArray[np.bool_]  # (N,) not meant to change
    reasons: list[str]  # (N,) why a point is left, "" while it can be moved
    held: NDArray[np.bool_]  # (N,) of a tool in the cell, seen from the work in the gripper
    hinted: NDArray[np.bool_]  # (N,) whose joints may only choose the posture of a pose
    axis_values: Array  # (N, A) of the cell's external axes
    axes_of: tuple[PointAxes, ...]  # by program
    solved: Array  # (N, n) joints that were computed for points that state none, while they are
    unusable: NDArray[np.bool_]  # (N,) whose joints are not where the robot stands there

    def __len__(self) -> int:
        return len(self.row)

    def tips_of(self, rows: Rows) -> Array:
        """Return the tip (K, 4, 4) in the user frame; of work in the gripper, the work seen from the tool."""
        tips = self.frame_tip[rows]
        held = self.held[rows]
        if held.any():
            tips = tips.copy()
            tips[held] = inverse_transform(tips[held])
        return tips

    def written_tips(self, rows: Rows, tips: Array) -> Array:
        """Return tips as `tips_of` has them, as they are written."""
        held = self.held[rows]
        if held.any():
            tips = tips.copy()
            tips[held] = inverse_transform(tips[held])
        return tips

    def begin_programs(self, rows: Rows, postures: Array, starting: StartingPostures) -> None:
        """Set the posture before a program's first rows where none is known: the last found, or the starting one."""
        firsts = np.flatnonzero(np.concatenate([[True], self.of[rows[1:]] != self.of[rows[:-1]]]))
        for first in firsts.tolist():
            program = int(self.of[rows[first]])
            begin = starting.of_program(self.programs[program].name)
            if begin is None or np.isfinite(postures[first]).all():
                continue
            before = np.flatnonzero(
                (self.of[: rows[first]] == program) & np.isfinite(self.solved[: rows[first], 0])
            )
            postures[first] = self.solved[before[-1]] if len(before) else begin

    def refuse_points(self, rows: Rows, why: str | Callable[[int], str]) -> None:
        """Leave points, for the first reason that was found."""
        for i in rows.tolist():
            self.reasons[i] = self.reasons[i] or (why if isinstance(why, str) else why(i))

    def keep_joint_points(self) -> None:
        """Let points in joint angles stay whose tool, frame or value is unknown: that depends on none."""
        for i, why in enumerate(self.reasons):
            if (
                why in UNKNOWN_FRAMES | VALUES_GIVEN
                and not self.cartesian[i]
                and np.isfinite(self.joints[i]).all()
            ):
                self.stays[i], self.reasons[i] = True, ""

    def taught_before(self, rows: Rows) -> Array:
        """Return joints (K, n) taught in the same program after the row before each of K rows, else NaN.

        A point that is left where it is tells the posture as well as one that is changed.
        """
        taught = np.flatnonzero(np.isfinite(self.joints).all(axis=1) & ~self.unusable)
        found = np.full((len(rows), self.joints.shape[1]), np.nan)
        if not len(taught):
            return found
        last = np.searchsorted(taught, rows) - 1
        at = taught[np.maximum(last, 0)]
        previous = np.concatenate([[-1], rows[:-1]])
        there = (last >= 0) & (self.of[at] == self.of[rows]) & (at > previous)
        found[there] = self.joints[at[there]]
        return found

    def open_rows(self) -> Rows:
        """Return the points that can be moved."""
        stays = self.stays.tolist()
        return np.array(
            [i for i, reason in enumerate(self.reasons) if not reason and not stays[i]], dtype=np.intp
        )


def points_of(programs: Sequence[ProgramFile], cell: Project) -> ProgramPoints:
    """Put the positions of programs of a cell side by side.

    Raises
    ------
    ProgramFileError
        A program of an arm with another number of joints: every joint position says so.
    """
    axes = cell.nominal.axis_count
    set_later = len(cell.axes) > 0 and any(sets_external_axes(one.brand, one.to_bytes()) for one in programs)
    found = [
        external_reasons(program, cell.axes, cell.standing_tools, axes, set_later=set_later)
        for program in programs
    ]
    leave_lists_of_programs(programs, found)
    all_of = [program.positions for program in programs]
    count = [len(positions) for positions in all_of]
    no_units = [lacks_units(one.brand, one.positions, cell.nominal) for one in programs]
    reasons = [
        ""
        if each.stays[row]
        else _first_reason(kind, p.barred.get(row, ""), axes)
        or each.reasons[row]
        or (NO_UNIT if bare[row] else "")
        for p, each, bare in zip(all_of, found, no_units, strict=True)
        for row, kind in enumerate(p.kinds)
    ]
    return ProgramPoints(
        programs=tuple(programs),
        of=np.repeat(np.arange(len(programs)), count).astype(np.intp),
        row=side_by_side([np.arange(n, dtype=np.intp) for n in count], np.zeros(0, dtype=np.intp)),
        cartesian=np.array([kind == CARTESIAN for p in all_of for kind in p.kinds], dtype=bool),
        frame_tip=side_by_side([p.frame_tip for p in all_of], np.zeros((0, 4, 4))),
        joints=side_by_side(
            [as_chain(one.brand, joints_of(one.positions, axes)) for one in programs], np.zeros((0, axes))
        ),
        texts=tuple(text for p in all_of for text in p.configurations),
        tools=tuple(name for p in all_of for name in p.tools),
        user_frames=tuple(name for p in all_of for name in p.user_frames),
        stays=side_by_side([each.stays for each in found], np.zeros(0, dtype=bool)),
        reasons=reasons,
        held=side_by_side([marked_rows(p, p.held_work) for p in all_of], np.zeros(0, dtype=bool)),
        hinted=side_by_side([marked_rows(p, p.posture_hints) for p in all_of], np.zeros(0, dtype=bool)),
        axis_values=side_by_side([each.point_axes.values for each in found], np.zeros((0, len(cell.axes)))),
        axes_of=tuple(each.point_axes for each in found),
        solved=np.full((sum(count), axes), np.nan),
        unusable=np.array([bool(reason) and reason not in UNKNOWN_FRAMES for reason in reasons], dtype=bool),
    )


@dataclass(frozen=True, eq=False)
class PointGroup:
    """Points that share tool and frame."""

    rows: Rows
    tool: str | None
    frame: str | None
    held: bool = False  # work in the gripper, at a tool that stands in the cell


def groups_of(points: ProgramPoints, programs_apart: bool) -> tuple[PointGroup, ...]:
    """Return the points by tool and frame; by program too where programs bring tools and frames of their own."""
    found: dict[tuple[str | None, str | None, int, bool], list[int]] = {}
    for i in points.open_rows().tolist():
        whose = int(points.of[i]) if programs_apart else -1
        key = (points.tools[i], points.user_frames[i], whose, bool(points.held[i]))
        found.setdefault(key, []).append(i)
    return tuple(
        PointGroup(np.array(rows, dtype=np.intp), key[0], key[1], key[3]) for key, rows in found.items()
    )


def _first_reason(kind: str, barred: str, axes: int) -> str:
    if barred:
        return barred
    if kind == UNTAUGHT:
        return "not taught"
    if kind == PULSES:
        return MISSING
    return "" if kind in (CARTESIAN, JOINTS) else f"holds {kind}, which is no position of {axes} joints"
