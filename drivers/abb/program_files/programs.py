"""RAPID modules as `ProgramFile`: lossless, span by span."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot, isnan
from pathlib import PurePath
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.geometry import Array, quaternion_from_rotation
from cellcal.calibration.message import make_message
from cellcal.drivers.abb.program_files.collected_positions import LEAST_ANGLE_DECIMALS
from cellcal.drivers.abb.program_files.configuration import AbbConfigurations, numbers_of
from cellcal.drivers.abb.program_files.declared_frames import with_standing_work
from cellcal.drivers.abb.program_files.declared_records import declared_records
from cellcal.drivers.abb.program_files.hidden_frames import with_local_frames
from cellcal.drivers.abb.program_files.instructions import MOVES
from cellcal.drivers.abb.program_files.literals import AGGREGATES
from cellcal.drivers.abb.program_files.measured_places import (
    frames_in_other_files,
    is_measured,
    measured_shifts,
)
from cellcal.drivers.abb.program_files.motion_configuration import (
    LISTS,
    UNKNOWN_ROBOT,
    base_frame_of,
    declarations_of,
    is_of_unknown_robot,
)
from cellcal.drivers.abb.program_files.rapid_called import NAMES
from cellcal.drivers.abb.program_files.rapid_module import read_module
from cellcal.drivers.abb.program_files.set_frames import (
    SetFrames,
    marks_of_set_frames,
    without_data_set_by_name,
    without_frames_of_others,
)
from cellcal.drivers.abb.program_files.shared_data import marks_of_shared_data, without_shared_data
from cellcal.drivers.abb.program_files.unchecked_configurations import ignores_configurations
from cellcal.drivers.abb.program_files.written_numbers import (
    LEAST_LENGTH_DECIMALS,
    LEAST_QUATERNION_DECIMALS,
    WrittenTargets,
)
from cellcal.drivers.programs.absent_places import absent_places
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.columns import BEYOND, gets_only_a_pose, part_of
from cellcal.drivers.programs.declared_poses import with_declared
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import (
    ExternalUses,
    FileDeclarations,
    lower_name,
    without_uncertain_tools,
)
from cellcal.drivers.programs.missing_ends import refuse_missing_end
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    PositionChange,
    Positions,
    ProgramFrames,
    Remark,
)
from cellcal.drivers.programs.settled_positions import settle_positions
from cellcal.drivers.programs.spans import (
    Edit,
    ProgramText,
    RequestedChange,
    checked_rows,
    finest_decimals,
    write_number,
)
from cellcal.drivers.programs.world_frames import seen_from_base, standing_remark

_MODULE = re.compile(  # a go.mod begins with "module github.com/…"
    rb"^(?:\xef\xbb\xbf)?[ \t]*+(?:MODULE[ \t]++[A-Za-z][\w\x80-\xff]*+(?![./-])|%%%)",
    re.IGNORECASE | re.MULTILINE,
)
_BEGINS = re.compile(r"^(?:\xef\xbb\xbf)?[ \t]*+MODULE[ \t]++[A-Za-z]\w*+", re.IGNORECASE | re.MULTILINE)
_ENDS = re.compile(r"\bENDMODULE\b", re.IGNORECASE)
_OTHER_TASK = "{} of its backup moves, too, and may be another robot: give the files of one task"
_LOOKED_AT = 1 << 16  # bytes in which a module names itself


@dataclass(frozen=True, eq=False)
class AbbFile:
    """One .mod, .prg, .sys, .modx or .sysx file."""

    source: ProgramText
    name: str
    positions: Positions
    remarks: tuple[Remark, ...]
    frames: ProgramFrames
    starts: NDArray[np.int64]  # (N,) where each target's numbers open
    written: WrittenTargets
    fixed: dict[int, str]  # targets that take no change, and why
    declarations: FileDeclarations  # what counts for other files
    keys: tuple[str, ...]  # (N,) the targets' names as other modules write them
    used: frozenset[int]  # rows that moves of this file go to
    declared: frozenset[str]  # its own tools and work objects, in small letters
    set_frames: SetFrames  # those of them that it sets to numbers
    brand: str = "abb"

    def to_bytes(self) -> bytes:
        """Return the file as it stands."""
        return self.source.data

    def with_changes(self, change: PositionChange) -> Self:
        """Return the file with new coordinates; see `drivers.programs.positions.ProgramFile`."""
        rows = checked_rows(self.source.name, self.positions, change)
        in_columns = gets_only_a_pose(rows, change, self.positions) & (self.written.widths[rows, 0] > 0)
        edits: list[Edit] = []
        if change.frame_tip is not None:
            some = rows[in_columns]
            edits += self.written.make_edits(some, self.starts[some], change.frame_tip[in_columns])
        if not in_columns.all():
            edits += self._make_edits(rows[~in_columns], part_of(change, ~in_columns))
        return type(self).from_bytes(self.source.name, self.source.apply_edits(edits))

    def _make_edits(self, rows: NDArray[np.int64], change: PositionChange) -> Iterator[Edit]:
        requested = RequestedChange.from_change(self.positions, rows, change)
        turns = _pose_quaternions(len(rows), change.frame_tip).tolist()
        for k, row in enumerate(rows.tolist()):
            configuration = _changed_text(change.configurations, k, self.positions.configurations[row])
            frame = _changed_text(change.user_frames, k, self.positions.user_frames[row] or "")
            if not (
                requested.has_pose[k]
                or requested.has_joints[k]
                or requested.has_external[k]
                or configuration is not None
                or frame is not None
            ):
                continue
            self._refuse_unfit(row, pose=requested.has_pose[k], joints=requested.has_joints[k], frame=frame)
            shape = "jointtarget" if self.positions.kinds[row] == JOINTS else "robtarget"
            found = AGGREGATES[shape].match_at(self.source.text, int(self.starts[row]))
            if requested.has_pose[k]:
                yield from self._pose_edits(row, found, requested.place_mm[k], turns[k])
            if requested.has_joints[k]:
                yield from self._joint_edits(row, found, requested.joints_deg[k])
            if configuration is not None:
                yield from self._configuration_edits(row, found, configuration)
            if requested.has_external[k]:
                yield from self._external_edits(row, found, requested.external[k])

    @classmethod
    def from_bytes(cls, name: str, data: bytes) -> Self:
        """Read a file.

        Raises
        ------
        ProgramFileError
            A target is not understood, or the file is none of these.
        """
        source = ProgramText(name, data)
        if b"\n" not in data and b"\r" in data:
            raise ProgramFileError(name, "its lines do not end as ABB's do.", remedy="Save it with CR LF.")
        refuse_missing_end(source, _BEGINS, _ENDS)
        module = read_module(source)
        found, count = module.found, len(module.found.names)
        order = np.argsort(np.array(found.starts, dtype=np.int64), kind="stable")
        user_frames = [module.uses.user_frames.get(row) for row in range(count)]
        tools = [module.uses.tools.get(row) for row in range(count)]
        uses = module.uses
        return cls(
            source=source,
            declarations=FileDeclarations(
                (module.name or PurePath(name).stem).lower(),
                declares=uses.shown,
                uses={
                    name: frozenset(frames_of_moves) for name, frames_of_moves in uses.external_uses.items()
                },
                doubtful=uses.facts.doubtful_frames()
                | marks_of_set_frames(uses.facts, name, source.text)
                | marks_of_shared_data(name, source.text),
                tools=module.frames.public_poses(module.frames.tools),
                bases=module.frames.public_poses(module.frames.bases),
                local_tools=module.frames.local_poses(module.frames.tools),
                local_bases=module.frames.local_poses(module.frames.bases),
                routine_targets=module.parameters.to_targets(uses),
                calls=tuple(uses.calls_of_other_files),
                routine_names=frozenset(module.parameters.routines),
                copies=uses.copies_for_other_files(),
                own_uses=uses.shown_uses(),
                named_tools=module.frames.public_tools(),
                moves=module.moves,
                other_data=declared_records(source.text) | module.computed.results_elsewhere(),
            ),
            keys=tuple(uses.local_keys.get(row, found.names[row].lower()) for row in order.tolist()),
            used=frozenset(k for k, row in enumerate(order.tolist()) if uses.of_row.get(row)),
            declared=frozenset(module.frames.declared),
            set_frames=SetFrames.of_literal(module.literal),
            name=module.name or PurePath(name).stem,
            positions=replace(
                _with_configurations_that_count(
                    found.to_positions(
                        order,
                        user_frames,
                        tools,
                        module.uses.barred,
                        module.shifts.to_shifts(found, module.uses),
                    ),
                    source.text,
                ),
                conditions={
                    k: uses.conditions[row] for k, row in enumerate(order.tolist()) if row in uses.conditions
                },
                held_work=frozenset(k for k, row in enumerate(order.tolist()) if row in uses.held_work),
            ),
            remarks=tuple(sorted(found.remarks, key=lambda remark: remark.line)),
            frames=module.frames.to_frames(),
            starts=np.array(found.starts, dtype=np.int64)[order],
            written=module.written.reorder_rows(order, found.fixed),
            fixed={k: found.fixed[row] for k, row in enumerate(order.tolist()) if row in found.fixed},
        )

    def with_external_uses(self, external_uses: ExternalUses) -> Self:
        """Return the file with what other modules say of its targets."""
        external_uses = with_local_frames(external_uses, self.declarations)
        positions, remarks = settle_positions(
            self.positions, external_uses, self.keys, used=self.used, taught=frozenset(), routines={}
        )
        frames = with_declared(
            self.frames, positions, external_uses.tools, external_uses.bases, own=self.declared
        )
        base = base_frame_of(external_uses)
        frames = seen_from_base(frames, base)
        standing = (standing_remark(base),) if base is not None and len(positions) else ()
        places = absent_places(self.source, external_uses.absent, MOVES, comment="!", statement_end=";")
        measured = (
            shift
            for name, uses in external_uses.uses.items()
            if is_measured(name)
            for shift in measured_shifts(self.source, name, frames_in_other_files(uses))
        )
        positions = replace(positions, shifts=(*positions.shifts, *places, *measured))
        positions = without_frames_of_others(positions, external_uses, self.set_frames, self.keys)
        positions = without_data_set_by_name(positions, external_uses)
        hidden = {*self.declarations.local_tools, *self.declarations.local_bases}
        positions = without_shared_data(positions, external_uses, self.keys, hidden)
        positions = _with_agreed_tools(positions, external_uses, self.keys)
        positions = _without_other_robots(positions, external_uses.other_task)
        if is_of_unknown_robot(external_uses):
            positions = _without_all(positions, UNKNOWN_ROBOT)
        positions = with_standing_work(positions, frames)
        return replace(self, positions=positions, frames=frames, remarks=(*standing, *self.remarks, *remarks))

    def _refuse_unfit(self, row: int, *, pose: bool, joints: bool, frame: str | None) -> None:
        kind = self.positions.kinds[row]
        if row in self.fixed:
            raise self._change_error(row, self.fixed[row])
        if frame is not None:
            raise self._change_error(row, "its work object stands in the moves, which are not rewritten")
        if (pose and kind != CARTESIAN) or (joints and kind != JOINTS):
            raise self._change_error(row, make_message("it holds {kind} coordinates", kind=kind))

    def _pose_edits(
        self, row: int, found: re.Match[str], place_mm: list[float], turn: list[float]
    ) -> Iterator[Edit]:
        texts = found.groups()[:7]
        length, digits = (
            finest_decimals(texts[:3], LEAST_LENGTH_DECIMALS),
            finest_decimals(texts[3:], LEAST_QUATERNION_DECIMALS),
        )
        yield from self._number_edits(row, found, 0, place_mm, length)
        old = [float(text) for text in texts[3:]]
        norm = hypot(*old)
        sign = -1.0 if sum(a * b for a, b in zip(turn, old, strict=True)) < 0 else 1.0
        new = [sign * value for value in turn]  # q and -q are one orientation; the file keeps its own
        if max(abs(a - b / norm) for a, b in zip(new, old, strict=True)) > 0.5 * 10.0**-digits:
            yield from self._number_edits(row, found, 3, new, digits)

    def _joint_edits(self, row: int, found: re.Match[str], joints_deg: list[float]) -> Iterator[Edit]:
        unused = np.isnan(self.positions.joints[row]).tolist()
        if any(gone and not isnan(value) for gone, value in zip(unused, joints_deg, strict=True)):
            raise self._change_error(row, "an axis that it leaves out is given a value")
        texts = [text for text, gone in zip(found.groups()[:6], unused, strict=True) if not gone]
        yield from self._number_edits(row, found, 0, joints_deg, finest_decimals(texts, LEAST_ANGLE_DECIMALS))

    def _external_edits(self, row: int, found: re.Match[str], values: list[float]) -> Iterator[Edit]:
        first = 6 if self.positions.kinds[row] == JOINTS else 11
        for k, value in enumerate(values):
            if isnan(value):
                continue
            if isnan(self.positions.external[row, k]):
                raise self._change_error(row, "an external axis that it leaves out is given a value")
            decimals = finest_decimals([found[first + k + 1]], LEAST_LENGTH_DECIMALS)
            yield from self._number_edits(row, found, first + k, [value], decimals)

    def _configuration_edits(self, row: int, found: re.Match[str], text: str) -> Iterator[Edit]:
        if numbers_of(text) is None:
            raise self._change_error(
                row, make_message("{text!r} is no configuration such as [0,-1,0,1]", text=text)
            )
        for k, part in enumerate(text.strip()[1:-1].split(",")):
            yield *found.span(8 + k), part.strip()

    def _number_edits(
        self, row: int, found: re.Match[str], first: int, values: list[float], decimals: int
    ) -> Iterator[Edit]:
        for k, value in enumerate(values):
            if isnan(value):
                continue
            if not abs(value) < BEYOND:
                raise self._change_error(
                    row, make_message("no robot has the coordinate {value:.0f}", value=value)
                )
            yield *found.span(first + k + 1), write_number(found[first + k + 1], value, decimals)

    def _change_error(self, row: int, why: str) -> ProgramFileError:
        return self.source.error_at(
            int(self.starts[row]),
            make_message("{names} cannot be changed: {why}.", names=self.positions.names[row], why=why),
            remedy="Leave it out, or teach it on the robot.",
        )


def _pose_quaternions(count: int, frame_tip: Array | None) -> Array:
    """Return (count, 4) quaternions of poses, NaN where there is none."""
    quaternions = np.full((count, 4), np.nan)
    if frame_tip is not None:
        is_given = ~np.isnan(frame_tip).any(axis=(1, 2))
        quaternions[is_given] = quaternion_from_rotation(frame_tip[is_given, :3, :3])
    return quaternions


def _changed_text(texts: Sequence[str] | None, k: int, old: str) -> str | None:
    return None if texts is None or texts[k] == old else texts[k]


def _with_agreed_tools(positions: Positions, external_uses: ExternalUses, keys: Sequence[str]) -> Positions:
    """Return positions of which joint targets have a tool only where all files agree on it."""
    tools = list(positions.tools)
    for row, kind in enumerate(positions.kinds):
        if kind == JOINTS:
            uses = without_uncertain_tools(external_uses.uses_of_name(keys[row]))
            named = {lower_name(move_frames.tool) for move_frames, _ in uses}
            named |= {lower_name(tools[row])} if tools[row] else set()
            alone = len(named) == 1 and "" not in named
            tool = tools[row] or next((each.tool for each, _ in uses), None)
            tools[row] = None if not alone or external_uses.doubt_reason(tool, None) else tool
    return replace(positions, tools=tuple(tools))


def _without_other_robots(positions: Positions, task: str) -> Positions:
    """Return positions that are all left where another task of their controller moves, too."""
    if not task:
        return positions
    return _without_all(positions, make_message(_OTHER_TASK, task))


def _without_all(positions: Positions, why: str) -> Positions:
    rows = [row for row, kind in enumerate(positions.kinds) if kind in (CARTESIAN, JOINTS)]
    return replace(positions, barred={**dict.fromkeys(rows, why), **positions.barred})


def writes_program(data: bytes) -> bool:
    """Return whether a .mod, .prg, .sys, .modx or .sysx file is a RAPID module: others use these suffixes, too."""
    return _MODULE.search(data, 0, _LOOKED_AT) is not None


def _with_configurations_that_count(positions: Positions, text: str) -> Positions:
    """Return positions without the configurations that no move looks at: each posture is the one next to the last."""
    return (
        replace(positions, configurations=("",) * len(positions))
        if ignores_configurations(text)
        else positions
    )


BRAND = ProgramBrand(
    brand="abb",
    suffixes=(".mod", ".prg", ".sys", ".modx", ".sysx"),
    read=AbbFile.from_bytes,
    configurations=AbbConfigurations(),
    writes_program=writes_program,
    tells=True,
    routine_names=NAMES,
    says=declarations_of,
    beside=LISTS,
)
