"""Which frame data (FDAT) a move is done with: its own, those of the inline form before it, or those of its block."""

import re
from collections.abc import Container, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Protocol

from cellcal.drivers.kuka.program_files.frame_uses import RESET
from cellcal.drivers.kuka.program_files.patterns import B
from cellcal.drivers.kuka.program_files.point_uses import EXTERNAL_TOOL, data_of
from cellcal.drivers.programs.barred import COMPUTED
from cellcal.drivers.programs.file_declarations import COPIED, ExternalUses, MoveFrames
from cellcal.drivers.programs.positions import CARTESIAN, Positions

_TOOL_OF = re.compile(rf"\$TOOL{B}*+={B}*+STOOL2?{B}*+\({B}*+(\w++)", re.ASCII | re.IGNORECASE)
_BASE_OF = re.compile(rf"\$BASE{B}*+={B}*+SBASE{B}*+\({B}*+(\w++)", re.ASCII | re.IGNORECASE)
_BEGIN_TOOL, _BEGIN_BASE = (
    "1",
    "0",
)  # BAS.SRC of KSS 8.2 to 8.6 (five public backups): TOOL_DATA[1], and the world
SET_DATA = "sets"  # before a name that a program gives a value, or a part of frame data
_MIXED_WORK = "it is taught with an external tool (IPO_FRAME #TCP), and moved to without its frame data"
_FRAME_SET = re.compile(rf"\$(?:TOOL|BASE)\b{B}*+(?:\.\w++{B}*+)?+=", re.IGNORECASE)


def data_taken(settings: str) -> str:
    """Return the frame data that a WITH takes tool and base from; "" where it takes them from elsewhere."""
    tools, bases = _TOOL_OF.findall(settings), _BASE_OF.findall(settings)
    if len(tools) != 1 or len(bases) != 1 or len(_FRAME_SET.findall(settings)) != 2:
        return ""
    return tools[0].upper() if tools[0].upper() == bases[0].upper() else ""


@dataclass
class FramesInForce:
    """The frame data that moves without their own are done with, along the text of a routine."""

    data: str = ""  # "" where something else set tool or base, or may have
    _stated: str = ""  # what an inline form has stated, and BAS() has not set yet
    _outside: str = ""  # of the spline block
    _branches: list[tuple[str, bool]] = field(
        default_factory=list
    )  # at the begin of each; whether one changed it

    def take_data(self, name: str) -> None:
        """Take frame data that an inline form states; ``BAS(#CP_PARAMS, …)`` sets tool and base to them."""
        self._stated = name.upper()

    def set_data(self) -> None:
        """Set tool and base to what is stated."""
        self.data = self._stated
        self._mark_changed()

    def forget(self) -> None:
        """Take note that tool or base may be others from here."""
        self.data = self._stated = ""
        self._mark_changed()

    def begin_block(self) -> None:
        """Enter a spline block, whose own tool and base end with it."""
        self._outside = self.data

    def end_block(self) -> None:
        """Leave a spline block."""
        self.data, self._outside = self._outside, ""

    def take_branch(self, word: str) -> None:
        """Enter, change or leave a branch; what was set in one holds behind it for no branch."""
        self._stated = ""
        if word in ("IF", "SWITCH"):
            self._branches.append((self.data, False))
        elif word in ("WHILE", "FOR"):  # its first line is reached from its last, too
            self.forget()
            self._branches.append(("", False))
        elif self._branches:
            before, changed = self._branches[-1]
            self.data = before
            if word.startswith("END"):
                self._branches.pop()
                if changed:
                    self.forget()

    def _mark_changed(self) -> None:
        for number in range(len(self._branches) - 1, -1, -1):
            before, changed = self._branches[number]
            if changed:  # and then those around it are marked, too
                return
            self._branches[number] = before, True


class TaughtFrames(Protocol):
    """The contents of frame data."""

    @property
    def tool(self) -> str | None: ...

    @property
    def base(self) -> str | None: ...

    @property
    def external_tool(self) -> bool: ...


def marks_of_set_data(names: Iterable[str], file: PurePath) -> dict[str, str]:
    """Return what a program says of the names that it gives a value, which may be frame data, to all data lists."""
    return {f"{SET_DATA} {name} {file}": COMPUTED for name in sorted(names)}


def data_set_by_programs(external_uses: ExternalUses, frame_data: Iterable[str]) -> Set[str]:
    """Return the frame data of a data list that programs give a value, or a part of it."""
    return {
        name
        for name in frame_data
        for program in external_uses.doubtful.rests_behind(f"{SET_DATA} {name}")
        if external_uses.file in external_uses.find_declarations(program, name)[0]
    }


def with_frame_data(
    external_uses: ExternalUses,
    frame_data: Mapping[str, TaughtFrames],
    set_data: Set[str],
    taught: Container[str] = (),
) -> ExternalUses:
    """Return the uses of a data list's points with the tools and bases of the frame data that each move takes.

    A name of frame data means those of the moving file's own data list before any others. Moves with data of
    another list than this one leave the point, and so do data that a program sets. A tool and base that a program
    reset, and set no others, are tool 1 and the world for points that were taught with their own; for others they
    are not said.
    """
    frame_data = {name: data for name, data in frame_data.items() if name not in set_data}
    uses = {}
    for name, some in external_uses.uses.items():
        found = [
            (_frames_of(move_frames, file, external_uses, frame_data), file) for move_frames, file in some
        ]
        uses[name] = [
            (without_reset(each, known=name in taught or each.why == COPIED), file) for each, file in found
        ]
    return replace(external_uses, uses=uses)


def without_reset(move_frames: MoveFrames, *, known: bool) -> MoveFrames:
    """Return the tool and base of a move with those of ``BAS(#INITMOV,0)`` in place of what its routine reset."""
    if RESET not in (move_frames.tool, move_frames.frame):
        return move_frames
    tool, frame = (
        (value if known else None) if each == RESET else each
        for each, value in ((move_frames.tool, _BEGIN_TOOL), (move_frames.frame, _BEGIN_BASE))
    )
    return move_frames._replace(tool=tool, frame=frame)


def _frames_of(
    move_frames: MoveFrames, file: str, external_uses: ExternalUses, frame_data: Mapping[str, TaughtFrames]
) -> MoveFrames:
    name = data_of(move_frames)
    if not name:
        return move_frames
    owners, there = external_uses.find_declarations(file, name)
    of_this_list = external_uses.file in owners and len({PurePath(each).stem.upper() for each in owners}) == 1
    data = frame_data.get(there) if of_this_list else None
    if move_frames.why == COPIED:  # to a copy of the point, which may be taken into this base
        tool, base = (None, None) if data is None else (data.tool, data.base)
        return move_frames._replace(tool=tool, frame=base)
    if data is None or data.tool is None or data.base is None:
        return MoveFrames(None, None, COMPUTED)
    return MoveFrames(None, None, EXTERNAL_TOOL) if data.external_tool else MoveFrames(data.tool, data.base)


def uses_of_own_data(declares: Mapping[str, bool]) -> dict[str, frozenset[MoveFrames]]:
    """Return the uses of points that other lists declare, by moves with this list's frame data of their names.

    ``FP1`` without ``XP1``: the program of this list moves to another's ``XP1`` with its own ``FP1``, which hides the
    other's. A move to a point with the frame data of its name is no use that its program notes.
    """
    computed_frames = frozenset((MoveFrames(None, None, COMPUTED),))
    points = {f"X{name[1:]}" for name in declares if name.startswith("F") and len(name) > 1}
    return dict.fromkeys(sorted(points - declares.keys()), computed_frames)


def without_mixed_work(positions: Positions, keys: Sequence[str], external_uses: ExternalUses) -> Positions:
    """Return positions of which those are left that are taught for a standing tool and moved to otherwise."""
    mixed = {row: _MIXED_WORK for row in positions.held_work if external_uses.uses_of_name(keys[row])}
    return replace(positions, barred={**mixed, **positions.barred}) if mixed else positions


def without_external_tools(positions: Positions, taught: Set[int], external_uses: ExternalUses) -> Positions:
    """Return positions of which those are left that another file lets be moved to with a tool in the cell.

    Points with frame data say themselves which tool is meant.
    """
    if not external_uses.external_tool:
        return positions
    rows = [row for row, kind in enumerate(positions.kinds) if kind == CARTESIAN and row not in taught]
    return replace(positions, barred={**dict.fromkeys(rows, EXTERNAL_TOOL), **positions.barred})
