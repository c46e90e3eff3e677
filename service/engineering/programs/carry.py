"""Carry points of programs from one cell to another, or within one: what clone, move and compensate share.

Programs are worked on together: their points are sorted by tool and frame, each sort goes through the arms in blocks,
and what fails is left as it was, with a reason.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from cellcal.calibration.compensation.pose_gap import Arm
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.programs.transfer import Transferred, Way, same_place, tips, transfer
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.cell_of_program import (
    Group,
    Points,
    Rows,
    bring_their_own,
    contradiction,
    frame_of,
    groups_of,
    in_no_frame,
    missing,
    name_in,
    points_of,
    refuse_foreign,
    tool_of,
)
from cellcal.service.engineering.programs.expected import Ends, Expectation
from cellcal.service.engineering.programs.judge import Judge
from cellcal.service.engineering.programs.outcome import Outcome, results_of
from cellcal.service.engineering.programs.postures import PostureSearch
from cellcal.service.engineering.programs.project import Project, Tool
from cellcal.service.engineering.programs.project_pulses import in_joints
from cellcal.service.engineering.programs.result import ProgramResult
from cellcal.service.engineering.programs.turned_shifts import find_turned_shifts

_BLOCK = 32768  # the few points that need many steps take them together
_CONTRADICTS_M = 5e-4  # between the joints and the pose of one position


@dataclass(frozen=True, eq=False)
class Passage:
    """One sort of points: tools and frames at both ends. A frame is None where only joints are programmed."""

    source_tool: Tool
    target_tool: Tool
    source_frame: Array | None
    target_frame: Array | None


class Route(Protocol):
    """What differs between moving, cloning and compensating."""

    @property
    def source(self) -> Project: ...
    @property
    def target(self) -> Project: ...

    @property
    def change(self) -> Array:
        """Return what carries places of the source's base into the target's (4, 4)."""
        ...

    def takes(self, frame: str | None, *, bare_joints: bool, in_joints: bool = False) -> bool | str:
        """Tell whether points of a user frame go this way, or why that is not known.

        ``in_joints`` are joint angles, ``bare_joints`` those whose program names no frame but the base.
        """
        ...

    def way(self, passage: Passage) -> Way:
        """Return the arms and the change of base for one sort of points."""
        ...

    def expectation(self, passage: Passage) -> Expectation:
        """Return what the expected errors come from."""
        ...


def _blocks(rows: Rows) -> Iterator[Rows]:
    for first in range(0, len(rows), _BLOCK):
        yield rows[first : first + _BLOCK]


class Carrier:
    """Carries programs along one route; what it prepares is kept for the next program."""

    def __init__(self, route: Route, rule: ConfigurationRule | None) -> None:
        self._route = route
        self._rule = rule
        source = route.source
        self._postures = PostureSearch(source.nominal, source.controller, rule)
        self._back = PostureSearch(route.target.nominal, route.target.controller, rule)
        self._judge = Judge.of(route.target, rule)

    def carry(self, programs: Sequence[ProgramFile]) -> tuple[ProgramResult, ...]:
        """Carry programs of one brand.

        Raises
        ------
        ProgramFileError
            A program of another robot or in another unit: nothing of it is written.
        CalibrationError
            Numbers that are not finite.
        """
        programs = in_joints(programs, self._route.source.pulses_per_rad)
        for program in programs:
            refuse_foreign(program, self._route.source)
        axes = self._route.source.nominal.axes
        points = points_of(programs, axes)
        result = Outcome.empty(len(points), axes)
        warnings: list[str] = []
        for group in groups_of(points, bring_their_own(programs) or self._rule is None):
            self._go(points, group, result, warnings)
        findings = find_turned_shifts(points, self._route)
        return results_of(points, result, warnings, findings, source=self._route.source)

    def _go(self, points: Points, group: Group, result: Outcome, warnings: list[str]) -> None:
        group = replace(group, rows=self._taken(points, group))
        passage = self._passage(points, group) if len(group.rows) else None
        if passage is None:
            return
        rows = group.rows if passage.source_frame is not None else group.rows[~points.cartesian[group.rows]]
        joints = self._programmed(points, rows, passage)
        known = np.isfinite(joints).all(axis=1)
        rows, joints = rows[known], joints[known]
        if not len(rows):
            return
        way, done = self._route.way(passage), np.zeros_like(joints)
        for first in range(0, len(rows), _BLOCK):
            block = slice(first, first + _BLOCK)
            done[block] = self._block(points, rows[block], joints[block], (way, passage), result)
        ends = Ends(joints, done, passage.source_tool, passage.target_tool)
        expectation = self._route.expectation(passage)
        result.expected_m[rows] = expectation.errors_m(ends)
        warnings += [word for word in expectation.unknown if word not in warnings]

    def _taken(self, points: Points, group: Group) -> Rows:
        """Return the points of a group that go this way; of the others it is said that they stay, or are left."""
        goes = np.ones(len(group.rows), dtype=bool)
        joints = ~points.cartesian[group.rows]
        program = points.programs[points.of[group.rows[0]]]
        in_base = in_no_frame(program, group.frame)
        frame = name_in(self._route.source, program, group.frame)
        for some, held in ((~joints, False), (joints, True)):
            taken = self._route.takes(frame, bare_joints=held and in_base, in_joints=held)
            if taken is not True:
                goes &= ~some
            if taken is False:
                points.stays[group.rows[some]] = True
            elif isinstance(taken, str):
                points.refuse(group.rows[some], taken)
        return group.rows[goes]

    def _passage(self, points: Points, group: Group) -> Passage | None:
        """Return tools and frames of a group; what is missing is said of its points."""
        program, route = points.programs[points.of[group.rows[0]]], self._route
        ends = (route.source, route.target)
        homes = [project is route.source for project in ends]
        for project, at_home in zip(ends, homes, strict=True):
            if why := contradiction(project, program, group.tool, group.frame, at_home=at_home):
                points.refuse(group.rows, why)
                return None
        tools = [
            tool_of(one, program, group.tool, at_home=home) for one, home in zip(ends, homes, strict=True)
        ]
        frames = [
            frame_of(one, program, group.frame, at_home=home) for one, home in zip(ends, homes, strict=True)
        ]
        cartesian = group.rows[points.cartesian[group.rows]]
        for project, tool, frame in zip(ends, tools, frames, strict=True):
            if tool is None:
                points.refuse(group.rows, missing("tool", group.tool, project))
            if frame is None:
                points.refuse(cartesian, missing("user frame", group.frame, project))
        if tools[0] is None or tools[1] is None:
            return None
        both = frames[0] is not None and frames[1] is not None
        return Passage(tools[0], tools[1], frames[0] if both else None, frames[1] if both else None)

    def _programmed(self, points: Points, rows: Rows, passage: Passage) -> Array:
        """Return the joints (K, n) that the source's controller computes, NaN for points that are left."""
        joints = points.joints[rows].copy()
        posed = np.flatnonzero(points.cartesian[rows])
        if not len(posed) or passage.source_frame is None:
            return joints
        flange = inverse_transform(passage.source_tool.entered)
        taught = np.isfinite(joints[posed]).all(axis=1)
        for some in _blocks(posed[taught]):
            poses = passage.source_frame @ points.frame_tip[rows[some]] @ flange
            self._compare(points, rows[some], joints[some], poses)
        before: Array | None = None
        for part in _blocks(posed[~taught]):
            poses = passage.source_frame @ points.frame_tip[rows[part]] @ flange
            texts = [points.texts[i] for i in rows[part].tolist()]
            postures = points.taught_before(rows[part])
            if before is not None and not np.isfinite(postures[0]).all():
                postures[0] = before
            joints[part], why = self._postures.joints(poses, texts, postures)
            known = part[np.isfinite(joints[part]).all(axis=1)]
            before = joints[known[-1]] if len(known) else before
            points.refuse(rows[part], dict(zip(rows[part].tolist(), why, strict=True)).__getitem__)
        return joints

    def _compare(self, points: Points, rows: Rows, joints: Array, base_flange: Array) -> None:
        """Leave positions whose joints and pose contradict: taught on another robot, or with another tool."""
        if not len(rows):
            return
        apart, _ = same_place(tips(Arm(self._route.source.controller), joints), base_flange)
        wrong = apart > _CONTRADICTS_M
        told = dict(zip(rows.tolist(), apart.tolist(), strict=True))
        points.refuse(
            rows[wrong],
            lambda i: (
                f"its joints and its pose are {told[i] * 1e3:.1f} mm apart: another robot's, or another tool"
            ),
        )

    def _block(
        self, points: Points, rows: Rows, joints: Array, by: tuple[Way, Passage], result: Outcome
    ) -> Array:
        found = self._transferred(points, rows, joints, by[0])
        self._judge.judge(points, rows, joints, found)
        texts = self._judge.spelled(points, rows, found.joints_rad)
        result.texts.update(texts)
        self._keep(points, rows, (joints, found), by, result)
        return found.joints_rad

    def _transferred(self, points: Points, rows: Rows, joints: Array, way: Way) -> Transferred:
        """Transfer points; those that do not arrive from their old joints begin at that posture of the new pose."""
        found = transfer(way, joints, careful=False)
        left = np.flatnonzero(~found.reached)
        if not len(left):
            return found
        flange = found.wanted[left] @ inverse_transform(way.target.flange_tip)
        start = self._back.alike(flange, joints[left])
        texts = [points.texts[i] for i in rows[left].tolist()]
        named = points.cartesian[rows[left]] & np.array([bool(text) for text in texts])
        if self._rule is not None and named.any():
            said = [text for text, there in zip(texts, named.tolist(), strict=True) if there]
            again, _ = self._back.joints(flange[named], said, None)
            start[named] = np.where(np.isfinite(again), again, start[named])
        other = transfer(way, joints[left], start_rad=np.where(np.isfinite(start), start, joints[left]))
        found.joints_rad[left], found.base_tip[left] = other.joints_rad, other.base_tip
        found.reached[left], found.left_m[left] = other.reached, other.left_m
        return found

    def _keep(
        self,
        points: Points,
        rows: Rows,
        joints: tuple[Array, Transferred],
        by: tuple[Way, Passage],
        result: Outcome,
    ) -> None:
        (old, found), (way, passage) = joints, by
        posed = points.cartesian[rows]
        controller = Arm(self._route.source.controller, passage.source_tool.entered)
        before = tips(controller, old)
        if passage.source_frame is not None and passage.target_frame is not None:
            before[posed] = passage.source_frame @ points.frame_tip[rows[posed]]
            new = inverse_transform(passage.target_frame) @ found.base_tip
            result.frame_tip[rows[posed]] = new[posed]
        shifted = np.eye(4) if passage.source_frame is None else passage.source_frame
        there = np.eye(4) if passage.target_frame is None else passage.target_frame
        result.shift_m[rows], result.turn_rad[rows] = same_place(
            inverse_transform(shifted) @ before, inverse_transform(there) @ found.base_tip
        )
        result.uncorrected_m[rows] = same_place(way.change @ before, found.base_tip)[0]
        written = ~posed | np.isfinite(points.joints[rows]).all(axis=1)
        if written.any():
            result.joints = result.joints if result.joints.flags.writeable else result.joints.copy()
            result.joints[rows[written]] = found.joints_rad[written]
        result.before[rows], result.after[rows] = before, found.base_tip
