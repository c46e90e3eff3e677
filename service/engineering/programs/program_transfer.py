"""Carry points of programs from one cell to another, or within one: what clone, move and compensate share.

Programs are worked on together: their points are sorted by tool and frame, each sort goes through the arms in blocks,
and what fails is left as it was, with a reason.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array, inverse_transform
from cellcal.calibration.message import make_message
from cellcal.calibration.programs.transfer import (
    TransferFrames,
    TransferResult,
    same_place,
    tip_poses,
    transfer_points,
)
from cellcal.calibration.programs.transfer_other_arms import transfer_other_arm
from cellcal.drivers.programs.brands import ConfigurationRule
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.cell_of_program import (
    bring_their_own,
    find_contradiction,
    frame_of,
    missing_reason,
    name_in,
    names_no_frame,
    refuse_foreign,
    tool_of,
)
from cellcal.service.engineering.programs.expected_accuracy import Expectation, TransferEnds
from cellcal.service.engineering.programs.external.carried_points import (
    CarriedChanges,
    CarriedPoints,
    rows_of_poses,
)
from cellcal.service.engineering.programs.external.point_groups import carry_group
from cellcal.service.engineering.programs.external.unconfirmed import led_findings, unconfirmed_meanings
from cellcal.service.engineering.programs.held_frames import warn_of_held_frames
from cellcal.service.engineering.programs.other_arm_checks import (
    check_tilts,
    own_leans,
    refuse_another_kind,
    rods_left_out,
)
from cellcal.service.engineering.programs.point_checks import TransferChecks
from cellcal.service.engineering.programs.point_outcomes import PointOutcomes, results_of
from cellcal.service.engineering.programs.posture_hints import CONTRADICTS_M, HINT_STAYS, joints_by_hints
from cellcal.service.engineering.programs.postures import PostureSearch, applied_rule, posture_search
from cellcal.service.engineering.programs.program_points import (
    PointGroup,
    ProgramPoints,
    Rows,
    groups_of,
    points_of,
)
from cellcal.service.engineering.programs.project_pulses import read_for_robot
from cellcal.service.engineering.programs.result import ProgramResult, with_further_findings
from cellcal.service.engineering.programs.transfer_route import FramePair, TransferRoute
from cellcal.service.engineering.programs.turned_shifts import find_turned_shifts
from cellcal.service.engineering.programs.written_tools import ambiguous_tool, unmeasured_tools

_BLOCK = 32768  # the few points that need many steps take them together


def _row_blocks(rows: Rows) -> Iterator[Rows]:
    for first in range(0, len(rows), _BLOCK):
        yield rows[first : first + _BLOCK]


class ProgramTransfer:
    """Carries programs along one route; what it prepares is kept for the next program."""

    def __init__(self, route: TransferRoute, rule: ConfigurationRule | None) -> None:
        self._route = route
        source = route.source
        refuse_another_kind(source, route.target)
        self._rule = applied_rule(source, rule)
        self._postures = posture_search(source, rule)
        self._other = route.target.other_arm
        self._back = PostureSearch(route.target.nominal, route.target.controller, rule)
        self._judge = TransferChecks.for_project(route.target, self._rule, source.axes)

    def transfer_programs(self, programs: Sequence[ProgramFile]) -> tuple[ProgramResult, ...]:
        """Carry programs of one brand.

        Raises
        ------
        ProgramFileError
            A program of another robot or in another unit: nothing of it is written.
        CalibrationError
            Numbers that are not finite.
        """
        source = self._route.source
        programs = read_for_robot(programs, source.pulses_per_rad, source.control_group)
        for program in programs:
            refuse_foreign(program, self._route.source)
        axes = self._route.source.nominal.axis_count
        points = points_of(programs, self._route.source)
        if self._route.keeps_joint_points:
            points.keep_joint_points()
        result = PointOutcomes.make_empty(len(points), axes)
        if len(self._route.source.axes):
            result.axis_values = np.full((len(points), len(self._route.target.axes)), np.nan)
            result.carried = CarriedChanges.make_empty(len(points))
        result.target_axes = self._route.target.axes
        warnings = [
            *self._judge.unchecked_shapes(points),
            *unconfirmed_meanings(points, source.axes),
        ]
        for group in groups_of(points, bring_their_own(programs) or self._rule is None):
            self._transfer_group(points, group, result, warnings)
        warnings += [
            *own_leans(points, result.left_rad),
            *rods_left_out(self._route.source, self._route.target),
        ]
        findings = find_turned_shifts(points, self._route, result.carried)
        results = self._with_doubts(
            points, results_of(points, result, warnings, findings, source=self._route.source)
        )
        if self._route.target is self._route.source:
            return results
        return tuple(warn_of_held_frames(each, self._route.target) for each in results)

    def _with_doubts(
        self, points: ProgramPoints, results: tuple[ProgramResult, ...]
    ) -> tuple[ProgramResult, ...]:
        """Return results with findings for points that rest on what nothing here confirms."""
        source, target = self._route.source, self._route.target
        starts = np.searchsorted(points.of, np.arange(len(results))).tolist()
        needs_tips = source is not target or self._route.real_ends != (True, True)
        found = []
        for start, result in zip(starts, results, strict=True):
            doubts = list(led_findings(points, start, result, source.axes))
            if needs_tips:
                doubts += unmeasured_tools(points, start, result, (source, target))
            found.append(with_further_findings(result, doubts))
        return tuple(found)

    def _transfer_group(
        self, points: ProgramPoints, group: PointGroup, result: PointOutcomes, warnings: list[str]
    ) -> None:
        group = replace(group, rows=self._covered_rows(points, group))
        frame_pair = self._frame_pair(points, group) if len(group.rows) else None
        if frame_pair is None:
            return
        rows = (
            group.rows if frame_pair.source_frame is not None else group.rows[~points.cartesian[group.rows]]
        )
        rows, carried = carry_group(points, rows, group, frame_pair, self._route)
        joints = self._programmed_joints(points, rows, (frame_pair, carried))
        has_joints = np.asarray(np.isfinite(joints).all(axis=1))
        rows, joints, carried = rows[has_joints], joints[has_joints], carried.of_rows(has_joints)
        if not len(rows):
            return
        way, done = self._way_of(frame_pair, carried), np.zeros_like(joints)
        for first in range(0, len(rows), _BLOCK):
            block = slice(first, first + _BLOCK)
            its = carried.of_rows(block)
            part = replace(way, change=rows_of_poses(way.change, block))
            by = (part, frame_pair, its)
            done[block] = self._transfer_block(points, rows[block], joints[block], by, result)
        ends = TransferEnds(joints, done, frame_pair.source_tool, frame_pair.target_tool)
        expectation = self._expectation_of(frame_pair, carried, way)
        errors_m = expectation.errors_m(ends)
        result.expected_m[rows] = errors_m
        remarks = (*expectation.undetermined_remarks(ends, errors_m), *expectation.unknown)
        warnings += [remark for remark in remarks if remark not in warnings]

    def _way_of(self, frame_pair: FramePair, carried: CarriedPoints) -> TransferFrames:
        """Return the arms and the change for them, which differs from point to point where axes carry them."""
        way = self._route.transfer_way(frame_pair)
        return replace(way, change=carried.change_of(frame_pair.work_change(self._route)))

    def _expectation_of(
        self, frame_pair: FramePair, carried: CarriedPoints, way: TransferFrames
    ) -> Expectation:
        found = self._route.make_expectation(frame_pair)
        carrier = None if carried.source_carrier.ndim == 2 else carried.source_carrier
        return replace(found, change=way.change, source_carrier=carrier)

    def _covered_rows(self, points: ProgramPoints, group: PointGroup) -> Rows:
        """Return the points of a group that go this way; of the others it is said that they stay, or are left."""
        goes = np.ones(len(group.rows), dtype=bool)
        joints = ~points.cartesian[group.rows]
        program = points.programs[points.of[group.rows[0]]]
        in_base = names_no_frame(program, group.frame)
        frame = name_in(self._route.source, program, group.frame)
        for some, by_joints in ((~joints, False), (joints, True)):
            taken = self._route.covers_frame(frame, bare_joints=by_joints and in_base, in_joints=by_joints)
            if taken is not True:
                goes &= ~some
            if taken is False:
                poses_go = self._route.covers_frame(frame, bare_joints=False) is True
                hints = some & points.hinted[group.rows] & joints & poses_go
                points.refuse_points(group.rows[hints], HINT_STAYS)
                points.stays[group.rows[some & ~hints]] = True
            elif isinstance(taken, str):
                points.refuse_points(group.rows[some], taken)
        return group.rows[goes]

    def _frame_pair(self, points: ProgramPoints, group: PointGroup) -> FramePair | None:
        """Return tools and frames of a group; what is missing is said of its points."""
        program, route = points.programs[points.of[group.rows[0]]], self._route
        ends = (route.source, route.target)
        if group.held:
            return self._standing_pair(points, group)
        homes = [project is route.source for project in ends]
        for project, at_home in zip(ends, homes, strict=True):
            why = find_contradiction(project, program, group.tool, group.frame, at_home=at_home)
            if why := why or ambiguous_tool(project, route.source, program, group.tool):
                points.refuse_points(group.rows, why)
                return None
        tools = [tool_of(one, program, group.tool, home=route.source) for one in ends]
        frames = [
            frame_of(one, program, group.frame, at_home=home) for one, home in zip(ends, homes, strict=True)
        ]
        cartesian = group.rows[points.cartesian[group.rows]]
        for project, tool, frame in zip(ends, tools, frames, strict=True):
            if tool is None:
                points.refuse_points(group.rows, missing_reason("tool", group.tool, project))
            if frame is None:
                points.refuse_points(cartesian, missing_reason("user frame", group.frame, project))
        if tools[0] is None or tools[1] is None:
            return None
        both = frames[0] is not None and frames[1] is not None
        return FramePair(tools[0], tools[1], frames[0] if both else None, frames[1] if both else None)

    def _standing_pair(self, points: ProgramPoints, group: PointGroup) -> FramePair | None:
        """Return work in the gripper as the tool, and the tool that stands in the cell as the frame."""
        brand, route = points.programs[points.of[group.rows[0]]].brand, self._route
        found = [
            project.standing_tools.of_position(brand, group.tool, group.frame)
            for project in (route.source, route.target)
        ]
        for project, tools in zip((route.source, route.target), found, strict=True):
            if tools is None:
                points.refuse_points(
                    group.rows,
                    make_message(
                        "no [standing_tools] and [held_work] in {path_name} for {tool} and {frame}",
                        path_name=project.file_name,
                        tool=group.tool,
                        frame=group.frame,
                    ),
                )
        first, second = found
        if first is None or second is None:
            return None
        (before, here), (after, there) = first, second
        return FramePair(here, there, before.entered, after.entered, (before, after))

    def _programmed_joints(
        self, points: ProgramPoints, rows: Rows, by: tuple[FramePair, CarriedPoints]
    ) -> Array:
        """Return the joints (K, n) that the source's controller computes, NaN for points that are left."""
        joints = points.joints[rows].copy()
        posed = np.flatnonzero(points.cartesian[rows])
        frame_pair, source_frame = by[0], by[1].source_frame
        if not len(posed) or source_frame is None:
            return joints
        flange = inverse_transform(frame_pair.source_tool.entered)
        taught = np.isfinite(joints[posed]).all(axis=1)
        controller = TipArm(self._route.source.controller)
        for some in _row_blocks(posed[taught]):
            poses = rows_of_poses(source_frame, some) @ points.tips_of(rows[some]) @ flange
            joints[some] = joints_by_hints(
                points, rows[some], (joints[some], poses), controller, self._postures
            )
            self._refuse_contradictions(points, rows[some], joints[some], poses, controller)
        before: Array | None = None
        for part in _row_blocks(posed[~taught]):
            poses = rows_of_poses(source_frame, part) @ points.tips_of(rows[part]) @ flange
            texts = [points.texts[i] for i in rows[part].tolist()]
            postures = points.taught_before(rows[part])
            if before is not None and not np.isfinite(postures[0]).all():
                postures[0] = before
            elif before is None:
                points.begin_programs(rows[part], postures, self._route.source.starting)
            joints[part], why = self._postures.find_joints(poses, texts, postures)
            solved = part[np.isfinite(joints[part]).all(axis=1)]
            before = joints[solved[-1]] if len(solved) else before
            points.solved[rows[solved]] = joints[solved]
            points.refuse_points(rows[part], dict(zip(rows[part].tolist(), why, strict=True)).__getitem__)
        return joints

    def _refuse_contradictions(
        self, points: ProgramPoints, rows: Rows, joints: Array, base_flange: Array, controller: TipArm
    ) -> None:
        """Leave positions whose joints and pose contradict: taught on another robot, or with another tool."""
        if not len(rows):
            return
        apart, _ = same_place(tip_poses(controller, joints), base_flange)
        wrong = apart > CONTRADICTS_M
        distances_m = dict(zip(rows.tolist(), apart.tolist(), strict=True))
        points.unusable[rows[wrong]] = True
        points.refuse_points(
            rows[wrong],
            lambda i: make_message(
                "its joints and its pose are {distances_mm:.1f} mm apart: another robot's, another tool, or joints "
                "that only choose the posture",
                distances_mm=distances_m[i] * 1000.0,
            ),
        )

    def _transfer_block(
        self,
        points: ProgramPoints,
        rows: Rows,
        joints: Array,
        by: tuple[TransferFrames, FramePair, CarriedPoints],
        result: PointOutcomes,
    ) -> Array:
        found = self._transfer_points(points, rows, joints, by[0])
        if self._other is not None:
            result.left_rad[rows] = found.left_rad
            check_tilts(points, rows, self._tilts(joints, by[0], by[1]), self._route.target)
        self._judge.check_points(points, rows, joints, found)
        texts = self._judge.new_configurations(points, rows, found.joints_rad)
        result.texts.update(texts)
        self._store_block(points, rows, (joints, found), by, result)
        return found.joints_rad

    def _transfer_points(
        self, points: ProgramPoints, rows: Rows, joints: Array, way: TransferFrames
    ) -> TransferResult:
        """Transfer points; those that do not arrive from their old joints begin at the new pose, in their posture."""
        if self._other is not None:
            return transfer_other_arm(way, joints, self._other)
        found = transfer_points(way, joints, careful=False)
        unreached = np.flatnonzero(~found.reached)
        if not len(unreached):
            return found
        flange = found.target_tip[unreached] @ inverse_transform(way.target.flange_tip)
        start = self._back.same_postures(flange, joints[unreached])
        texts = [points.texts[i] for i in rows[unreached].tolist()]
        named = points.cartesian[rows[unreached]] & np.array([bool(text) for text in texts])
        if self._rule is not None and named.any():
            configurations = [text for text, there in zip(texts, named.tolist(), strict=True) if there]
            again, _ = self._back.find_joints(flange[named], configurations, None)
            start[named] = np.where(np.isfinite(again), again, start[named])
        other = transfer_points(
            replace(way, change=rows_of_poses(way.change, unreached)),
            joints[unreached],
            start_rad=np.where(np.isfinite(start), start, joints[unreached]),
        )
        found.joints_rad[unreached], found.base_tip[unreached] = other.joints_rad, other.base_tip
        found.reached[unreached], found.left_m[unreached] = other.reached, other.left_m
        return found

    def _tilts(self, joints: Array, way: TransferFrames, frame_pair: FramePair) -> Array:
        """Return how far the change alone turns points beyond what the arm can follow (N,), without its errors."""
        assert self._other is not None
        source = TipArm(self._route.source.controller, frame_pair.source_tool.entered)
        nominal = replace(way, source=source, target=way.written)
        found = transfer_other_arm(nominal, joints, self._other)
        return np.where(found.left_m < CONTRADICTS_M, found.left_rad, 0.0)  # beyond its reach: that is said

    def _store_block(
        self,
        points: ProgramPoints,
        rows: Rows,
        joints: tuple[Array, TransferResult],
        by: tuple[TransferFrames, FramePair, CarriedPoints],
        result: PointOutcomes,
    ) -> None:
        (old, found), (way, frame_pair, carried) = joints, by
        posed = points.cartesian[rows]
        controller = TipArm(self._route.source.controller, frame_pair.source_tool.entered)
        before = tip_poses(controller, old)
        here, there = carried.source_frame, carried.target_frame
        if here is not None and there is not None:
            before[posed] = rows_of_poses(here, posed) @ points.tips_of(rows[posed])
            new = inverse_transform(there) @ found.base_tip
            result.frame_tip[rows[posed]] = points.written_tips(rows[posed], new[posed])
        result.shift_m[rows], result.turn_rad[rows] = same_place(
            inverse_transform(np.eye(4) if here is None else here) @ before,
            inverse_transform(np.eye(4) if there is None else there) @ found.base_tip,
        )
        result.uncorrected_m[rows] = same_place(way.change @ before, found.base_tip)[0]
        if result.carried is not None:
            result.carried.store_changes(rows, carried, way.change)
            result.axis_values[rows] = carried.target_values
        written = ~posed | np.isfinite(points.joints[rows]).all(axis=1)
        if written.any():
            result.joints = result.joints if result.joints.flags.writeable else result.joints.copy()
            result.joints[rows[written]] = found.joints_rad[written]
        result.before[rows], result.after[rows] = before, found.base_tip
