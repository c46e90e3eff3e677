"""A Yaskawa job as positions in columns, and back: only numbers of changed positions differ."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellcal.calibration.geometry import Array, Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import BatchReasons, ExternalUses, FileDeclarations
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    NO_NUMBER,
    PositionChange,
    Positions,
    ProgramFrames,
    Remark,
)
from cellcal.drivers.programs.shifts import NO_TURN, ProgramShift, ShiftAxes
from cellcal.drivers.yaskawa.program_files.job_amounts import is_straight_amount, may_shifts_turn
from cellcal.drivers.yaskawa.program_files.job_axis_rows import select_rows_alone
from cellcal.drivers.yaskawa.program_files.job_calls import (
    declarations_of,
    frames_from_others,
    frames_of_calls,
    frames_of_people,
    shift_from_others,
)
from cellcal.drivers.yaskawa.program_files.job_columns import (
    PULSES,
    SHIFT,
    kind_of,
    positions_of,
    unknown_configurations,
)
from cellcal.drivers.yaskawa.program_files.job_edits import RATIOS_NEEDED, edits_of
from cellcal.drivers.yaskawa.program_files.job_external import rows_beside, rows_that_share
from cellcal.drivers.yaskawa.program_files.job_motions import UNFILLED_AMOUNT, motions_in
from cellcal.drivers.yaskawa.program_files.job_remarks import remarks_of
from cellcal.drivers.yaskawa.program_files.job_shared_variables import computed_elsewhere, is_placed
from cellcal.drivers.yaskawa.program_files.job_text import ROBOT_ROWS, JobRow, YaskawaJob, jobs_of

ROBOT = 1  # whose jobs are read as those of the robot, where nothing else is said
_SWITCHED_ON = "it stands below ///{} ON, and what that says of a position is not known"
_OTHER_ROBOT = (
    "its job moves RB{} there, and the project's robot is RB{}: give the other's own project, with control_group "
    "under [robot]"
)
_MADE_BY = "{} makes its user frame or tool while it runs"
_CALLED_IN = "{} calls its job in another user frame than the one that it stands in"


@dataclass(frozen=True)
class JobProgram:
    """One .JBI file; ``drivers.programs.positions.ProgramFile``."""

    file: str
    data: bytes = field(repr=False)
    name: str
    positions: Positions = field(repr=False)
    remarks: tuple[Remark, ...] = field(repr=False)
    frames: ProgramFrames = field(repr=False)
    rows: tuple[JobRow, ...] = field(repr=False)
    jobs: tuple[str, ...] = field(repr=False)  # whose row each is
    pulses_per_rad: tuple[float, ...] | None = None
    robot: int = ROBOT  # whose positions are those of motion group 1
    external_uses: ExternalUses | None = field(
        default=None, repr=False
    )  # what the controller's other jobs say
    brand: str = "yaskawa"
    beside: Mapping[tuple[int, tuple[str, ...]], JobRow] = field(default_factory=dict, repr=False)
    alone: Mapping[str, int] = field(
        default_factory=dict, repr=False
    )  # rows that axes go to without the robot, and the line

    @property
    def declarations(self) -> FileDeclarations:
        """Return what counts for other jobs of the controller."""
        return declarations_of(self.file, self.data)

    def with_external_uses(self, external_uses: ExternalUses | None) -> "JobProgram":
        """Return the program with the shifts of other jobs that may be on in its own."""
        if external_uses is None or not external_uses.doubtful:
            return self
        names = set(self.jobs)
        shifting = {name: shift_from_others(self.file, name, external_uses.doubtful) for name in names}
        making = {name: frames_from_others(self.file, name, external_uses.doubtful) for name in names}
        in_frames = {name: frames_of_calls(self.file, name, external_uses.doubtful) for name in names}
        turn = (
            None if any(shifting.values()) and may_shifts_turn(self.file, external_uses.doubtful) else NO_TURN
        )
        shifts = [
            ProgramShift(
                int(self.positions.lines[row]),
                shifting[self.jobs[row]],
                ShiftAxes.BASE,
                (row,),
                quaternion=turn,
            )
            for row, kind in enumerate(self.positions.kinds)
            if kind in (CARTESIAN, JOINTS) and shifting[self.jobs[row]]
        ]
        made = {
            row: make_message(_MADE_BY, maker)
            for row, job_row in enumerate(self.rows)
            if (maker := _maker_of(job_row, making[self.jobs[row]]))
        }
        elsewhere = {
            row: make_message(_CALLED_IN, caller)
            for row, job_row in enumerate(self.rows)
            if (caller := _caller_elsewhere(job_row, in_frames[self.jobs[row]]))
        }
        marks = external_uses.doubtful
        computed = {
            row: why
            for row, each in enumerate(self.rows)
            if each.kind == "P"
            and (why := computed_elsewhere(self.file, self.jobs[row], int(each.number), marks))
        }
        own = [
            one
            for one in self.positions.shifts
            if not (one.absent and _is_stated_elsewhere(self.file, one.point, marks))
        ]
        shifts += self._frames_of_people(marks)
        own = [
            replace(one, quaternion=NO_TURN) if one.what in _settled_amounts(self.file, own, marks) else one
            for one in own
        ]
        if not (shifts or made or elsewhere or computed) and own == list(self.positions.shifts):
            return self
        positions = replace(
            self.positions,
            shifts=(*own, *shifts),
            barred={**computed, **elsewhere, **made, **self.positions.barred},
        )
        return replace(self, positions=positions, external_uses=external_uses)

    def _frames_of_people(self, marks: BatchReasons) -> list[ProgramShift]:
        """Return once for each job and frame that another job makes the frame when a person runs that."""
        makers = {name: frames_of_people(self.file, name, marks) for name in set(self.jobs)}
        found: dict[tuple[str, str], ProgramShift] = {}
        for row, job_row in enumerate(self.rows):
            made = makers[self.jobs[row]]
            maker = _maker_of(job_row, {key: name for key, name in made.items() if key[0] == "UF"})
            frame = self.positions.user_frames[row]
            if maker and frame is not None and (maker, frame) not in found:
                line = int(self.positions.lines[row])
                found[maker, frame] = ProgramShift(
                    line,
                    "MFRAME",
                    ShiftAxes.USER_FRAME,
                    point=f"UF#({frame})",
                    user_frame=frame,
                    made_by=maker,
                )
        return list(found.values())

    def external_row(self, row: int, kinds: tuple[str, ...]) -> JobRow | None:
        """Return the row of base or station axes beside a position; None where there is none."""
        return self.beside.get((row, kinds))

    def to_bytes(self) -> bytes:
        """Return the file."""
        return self.data

    def with_changes(self, change: PositionChange) -> "JobProgram":
        """Return the file with new coordinates.

        Raises
        ------
        ProgramFileError
            A number that does not fit, a pulse position without ratios, another configuration or frame.
        """
        pieces, at = [], 0
        for start, old, new in edits_of(self, change):
            pieces += [self.data[at:start], new.encode("ascii")]
            at = start + len(old)
        data = b"".join([*pieces, self.data[at:]])
        changed = read_job(self.file, data, pulses_per_rad=self.pulses_per_rad, robot=self.robot)
        return changed.with_external_uses(self.external_uses)


def _is_stated_elsewhere(file: str, point: str, marks: BatchReasons) -> bool:
    """Return whether a position variable is a place that a job of the folder states."""
    found = re.fullmatch(r"PX?0*(\d+)", point)
    return found is not None and is_placed(file, found[1], marks)


def _settled_amounts(file: str, shifts: Sequence[ProgramShift], marks: BatchReasons) -> set[str]:
    """Return the shifts, as they are named, by an amount that another job fills, and that nothing there turns."""
    found = set[str]()
    for what in {one.what for one in shifts if one.quaternion is None}:
        amount = UNFILLED_AMOUNT.fullmatch(what)
        if amount is not None and is_straight_amount(file, int(amount[1]), marks):
            found.add(what)
    return found


def _maker_of(row: JobRow, made: Mapping[tuple[str, str], str]) -> str:
    """Return the job that makes a row's user frame or tool, "" where none does."""
    if row.state.mode != "RECTAN":
        return ""
    user = row.state.user if row.state.postype == "USER" else None
    for (what, number), maker in made.items():
        active_number = user if what == "UF" else row.state.tool
        if active_number is not None and (not number.isdigit() or int(number) == int(active_number)):
            return maker
    return ""


def _caller_elsewhere(row: JobRow, in_frames: Mapping[str, str]) -> str:
    """Return a job that calls a row's relative job in another user frame than the row's, "" where none does."""
    if row.state.mode != "RECTAN" or row.state.postype != "USER":
        return ""
    user = int(row.state.user or 0)
    return next(
        (name for number, name in in_frames.items() if not number.isdigit() or int(number) != user), ""
    )


def read_job(
    name: str, data: bytes, *, pulses_per_rad: Sequence[float] | Array | None = None, robot: int = ROBOT
) -> JobProgram:
    """Read a job.

    Parameters
    ----------
    pulses_per_rad
        Of each axis of the robot, with sign, so that pulses become the angles that the controller shows.
    robot
        The robot, as RB1 or RB2 of a job's header name it, whose positions are those of motion group 1.

    Raises
    ------
    ProgramFileError
        The file is damaged or not understood, with line and column; or ratios that are none.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise ProgramFileError(name, "this is UTF-16.", remedy="Save it as the controller writes it.")
    ratios = None if pulses_per_rad is None else np.asarray(pulses_per_rad, dtype=float)
    if ratios is not None and (ratios.ndim != 1 or not np.isfinite(ratios).all() or (ratios == 0).any()):
        raise ProgramFileError(name, "pulses per radian must be finite and not zero, one for each axis.")
    jobs = jobs_of(name, data.decode("latin-1"))
    remarks_by_job = [remarks_of(job) for job in jobs]
    rows = [row for job in jobs for row in job.rows if row.kind in ROBOT_ROWS]
    kinds = [
        kind_of(row, ratios, used.others, used.points)
        for job, (_, used) in zip(jobs, remarks_by_job, strict=True)
        for row in job.rows
        if row.kind in ROBOT_ROWS
    ]
    robots = [
        used.robot_of(row.kind, int(row.number))
        for job, (_, used) in zip(jobs, remarks_by_job, strict=True)
        for row in job.rows
        if row.kind in ROBOT_ROWS
    ]
    groups = [1 if one == robot else max(one, 2) for one in robots]
    positions = positions_of(name, jobs, rows, kinds, groups, ratios)
    barred, shifts = motions_in(jobs, positions)
    others = {i: make_message(_OTHER_ROBOT, one, robot) for i, one in enumerate(robots) if one != robot}
    beside = rows_beside(jobs, rows)
    broken = unknown_configurations(rows) | {i: NO_NUMBER for i, row in enumerate(rows) if row.broken}
    broken |= {i: NO_NUMBER for (i, _), row in beside.items() if row.broken}
    broken |= {
        i: make_message(_SWITCHED_ON, row.state.switched_on[-1])
        for i, row in enumerate(rows)
        if row.state.switched_on
    }
    positions = replace(
        positions,
        barred={**barred, **broken, **others},
        shifts=shifts,
        shared_external=rows_that_share(beside),
    )
    remarks = [remark for notes, _ in remarks_by_job for remark in notes] + _kind_remarks(positions)
    return JobProgram(
        file=name,
        data=data,
        name=jobs[0].name or name,
        positions=positions,
        remarks=tuple(sorted(remarks, key=lambda remark: remark.line)),
        frames=_frames_without_number(jobs),
        rows=tuple(rows),
        jobs=tuple(job.name for job in jobs for row in job.rows if row.kind in ROBOT_ROWS),
        pulses_per_rad=None if ratios is None else tuple(float(ratio) for ratio in ratios),
        robot=robot,
        beside=beside,
        alone=select_rows_alone(jobs, beside.values()),
    )


def _frames_without_number(jobs: list[YaskawaJob]) -> ProgramFrames:
    """Return the frames that need no number: the robot's own, and the base's where nothing carries the robot."""
    carried = any(row.kind in ("BC", "BP") for job in jobs for row in job.rows) or any(
        word.startswith("GROUP") and "BS" in rest for job in jobs for _, word, rest in job.header
    )
    own = {"ROBOT": Pose((0.0, 0.0, 0.0))}
    return ProgramFrames(base_frame=own if carried else own | {"BASE": Pose((0.0, 0.0, 0.0))})


def _kind_remarks(positions: Positions) -> list[Remark]:
    remarks = []
    if PULSES in positions.kinds:
        line = int(positions.lines[positions.kinds.index(PULSES)])
        remarks.append(Remark(line, "pulses", RATIOS_NEEDED))
    shifts = [i for i, kind in enumerate(positions.kinds) if kind == SHIFT]
    remarks += [
        Remark(
            int(positions.lines[i]),
            "position_register",
            make_message(
                "{names} is a variable that no move of this job goes to, or that it also computes with: "
                "it stays as written.",
                names=positions.names[i],
            ),
        )
        for i in shifts
    ]
    return remarks
