"""Positions of a robot program, in columns: what every brand's reader gives and takes back.

A program's positions are read into arrays, because a line has a million of them; names and frames stay as the
maker writes them, because people look for them on the pendant.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array, Pose
from cellcal.drivers.programs.conditions import Conditions, ExternalColumn
from cellcal.drivers.programs.shifts import ProgramShift

Kind = str
CARTESIAN, JOINTS, UNTAUGHT = "cartesian", "joints", "untaught"
NO_NUMBER = "a coordinate of it is no number, and it is not read"
UNREAD = "unread"  # numbers of a position that stand in the file and are not changed; `barred` says why


@dataclass(frozen=True, slots=True)
class Positions:
    """N recorded positions in the order of the file; of a URScript in the order of its moves.

    ``frame_tip`` is NaN where a position is not Cartesian, ``joints`` where it holds none; a UR waypoint holds both.
    Joints are what the controller shows, in its own coupling [rad, or m for a linear axis].
    """

    names: tuple[str, ...]  # "P[3]", "XP1", "p10"; unique within a group
    kinds: tuple[Kind, ...]  # CARTESIAN, JOINTS, UNTAUGHT, or a maker's own, which is never moved
    lines: NDArray[np.int64]  # (N,) where it stands in the file, from 1
    groups: NDArray[np.int64]  # (N,) motion group, 1 where the maker has none
    frame_tip: Array  # (N, 4, 4) the tool tip in the user frame [m]
    joints: Array  # (N, n) with n the most joints that a position of this file holds
    external: (
        Array  # (N, k) external axes [rad or m], NaN for none, inf where one is no number: its row is barred
    )
    user_frames: tuple[
        str | None, ...
    ]  # as the file names it ("1", "wobj_left"); None: the file does not say
    tools: tuple[str | None, ...]
    configurations: tuple[str, ...]  # the maker's spelling with turn numbers, "" where there is none
    resolution_m: Array  # (N,) one unit of the last decimal of a length as written
    resolution_rad: Array  # (N,)
    barred: Mapping[int, str] = field(default_factory=dict)  # rows that no command may change, and why
    shifts: tuple[ProgramShift, ...] = ()  # what the program adds to points while it runs
    external_columns: tuple[
        ExternalColumn, ...
    ] = ()  # (k + m,) of `external` and, behind them, of `group_axes`
    group_axes: Array | None = None  # (N, m) joints of groups that are no arm, beside the robot's positions
    conditions: Conditions = field(default_factory=dict)  # rows that a project's statement makes changeable
    held_work: frozenset[int] = frozenset()  # rows of a standing tool, seen from the work in the gripper
    standing_frames: frozenset[int] = frozenset()  # rows whose frame no axis turns, as their programs say
    posture_hints: frozenset[int] = frozenset()  # rows whose joints may only choose the posture of a pose
    shared_external: tuple[
        tuple[int, ...], ...
    ] = ()  # rows whose external axes stand in one place of the file

    def __len__(self) -> int:
        """Return N."""
        return len(self.names)

    @property
    def all_external_axes(self) -> Array:
        """Return the axes (N, k + m) that stand beside the robot's own, those of other groups last."""
        return self.external if self.group_axes is None else np.hstack([self.external, self.group_axes])


@dataclass(frozen=True, slots=True)
class Remark:
    """Something in a program that a person must know before its positions are changed."""

    line: int  # from 1; 0 for the whole file
    code: str  # "position_register", "offset", "indirect", "relative", "computed", "vision", "foreign"
    text: str  # what it is and what it means here, as a sentence


@dataclass(frozen=True, slots=True)
class PositionChange:
    """New coordinates for some positions of a program; everything else keeps every byte.

    ``rows`` index `Positions`. What is None, and every row of NaN, stays as written. A configuration is the whole
    text as the maker spells it.
    """

    rows: NDArray[np.int64]  # (K,)
    frame_tip: Array | None = None  # (K, 4, 4) [m]
    joints: Array | None = None  # (K, n) [rad or m]
    configurations: Sequence[str] | None = None
    user_frames: Sequence[str] | None = None  # only makers that write a frame's number at a position
    external: Array | None = None  # (K, k + m) as `Positions.all_external_axes`


class ProgramFile(Protocol):
    """One file of one brand, read without losing a byte."""

    @property
    def brand(self) -> str:
        """Return the brand's package name: ``fanuc``, ``kuka``, ``abb``, ``universal_robots``, ``yaskawa``."""
        ...

    @property
    def name(self) -> str:
        """Return the program's own name, as on the pendant."""
        ...

    @property
    def positions(self) -> Positions:
        """Return every recorded position."""
        ...

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Return what else in this program carries or changes positions."""
        ...

    @property
    def frames(self) -> "ProgramFrames":
        """Return the tools, user frames and kinematics that this file itself holds."""
        ...

    def to_bytes(self) -> bytes:
        """Return the file; unchanged it is the bytes that were read."""
        ...

    def with_changes(self, change: PositionChange) -> Self:
        """Return the file with new coordinates in the number format of the old ones.

        Raises
        ------
        ProgramFileError
            A number that does not fit the format, a position that cannot take what is given, or is not finite.
        """
        ...


@dataclass(frozen=True, slots=True)
class ProgramFrames:
    """Tools and user frames by the name that positions use for them."""

    base_frame: Mapping[str, Pose] = field(default_factory=dict)
    flange_tip: Mapping[str, Pose] = field(default_factory=dict)
    kinematics: RobotModel | None = None  # of the robot this file was taught on, where it says so (UR)
    # What other files of its cell declare: true there, and not where the program is taken to.
    cell_base_frame: Mapping[str, Pose] = field(default_factory=dict)
    cell_flange_tip: Mapping[str, Pose] = field(default_factory=dict)
    sets_tools: bool = False  # it sets its tools to these poses while it runs, whatever its controller has


def with_unread(positions: Positions, unread: Sequence[tuple[str, int, str]]) -> Positions:
    """Return positions with others behind them that are not changed: name, line, and why."""
    if not unread:
        return positions
    more, count = len(unread), len(positions)
    names = list(positions.names)
    for name, line, _ in unread:
        names.append(name if name not in names else f"{name} (line {line}, {len(names) + 1})")

    def pad_rows(values: Array) -> Array:
        return np.concatenate([values, np.full((more, *values.shape[1:]), np.nan)])

    nothing: tuple[str | None, ...] = (None,) * more
    return replace(
        positions,
        names=tuple(names),
        kinds=(*positions.kinds, *(UNREAD,) * more),
        lines=np.concatenate([positions.lines, [line for _, line, _ in unread]]).astype(np.int64),
        groups=np.concatenate([positions.groups, np.ones(more, dtype=np.int64)]),
        frame_tip=pad_rows(positions.frame_tip),
        joints=pad_rows(positions.joints),
        external=pad_rows(positions.external),
        group_axes=None if positions.group_axes is None else pad_rows(positions.group_axes),
        user_frames=(*positions.user_frames, *nothing),
        tools=(*positions.tools, *nothing),
        configurations=(*positions.configurations, *("",) * more),
        resolution_m=np.concatenate([positions.resolution_m, np.ones(more)]),
        resolution_rad=np.concatenate([positions.resolution_rad, np.ones(more)]),
        barred={**positions.barred, **{count + k: why for k, (_, _, why) in enumerate(unread)}},
    )
