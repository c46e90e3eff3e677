"""Calls of programs that are not given: the places that these go to are not changed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from cellcal.calibration.geometry import Array, log_rotation
from cellcal.calibration.message import make_message
from cellcal.drivers.program_registry import brand_named, brand_of
from cellcal.drivers.programs.called_routines import CalledRoutine, moves_no_robot
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs.batches import ReadProgram
from cellcal.service.engineering.programs.files import ProgramSource, read_bytes
from cellcal.service.engineering.programs.result import PointFinding, ProgramResult, with_further_findings

_LEAST_M, _LEAST_RAD = 1e-5, math.radians(0.005)  # as of shifts: what a pendant shows
_CURE = "Give its file, too, or name it under programs_without_motion in the project."
_STAYS = (
    "{name} is called, and its file is not given: the places that it goes to stay, and the work moves by "
    "{distance} mm and turns by {angle} deg. {cure}"
)
_OF_OTHER_CONTROLLER = (
    "{name} is called, and its file is not given: what the other robot's controller has under that name "
    "counts. {cure}"
)
_NOT_CORRECTED = (
    "{name} is called, and its file is not given: the places that it goes to are not corrected. {cure}"
)
WriteText = Callable[[str], str]  # of a routine's name


@dataclass(frozen=True, eq=False)
class CallsNotGiven:
    """Finds calls of programs that are not given, and what that means for one change."""

    write_text: WriteText
    without_motion: tuple[str, ...] = ()  # patterns of the project, in capitals
    angle_rad: float = 0.0  # by which the work turns

    @classmethod
    def for_move(cls, base_change: Array, without_motion: Sequence[str]) -> "CallsNotGiven | None":
        """Return what is said of a move; nothing where nothing moves."""
        angle = float(np.linalg.norm(log_rotation(base_change[:3, :3])))
        distance_m = float(np.linalg.norm(base_change[:3, 3]))
        if angle <= _LEAST_RAD and distance_m <= _LEAST_M:
            return None

        def write_text(name: str) -> str:
            return make_message(
                _STAYS,
                name=name,
                distance=f"{distance_m * 1000.0:.2f}",
                angle=f"{math.degrees(angle):.2f}",
                cure=_CURE,
            )

        return cls(write_text, _in_capitals(without_motion), angle)

    @classmethod
    def for_clone(cls, without_motion: Sequence[str]) -> "CallsNotGiven":
        """Return what is said of a clone."""
        return cls(
            lambda name: make_message(_OF_OTHER_CONTROLLER, name=name, cure=_CURE),
            _in_capitals(without_motion),
        )

    @classmethod
    def for_compensation(cls, without_motion: Sequence[str]) -> "CallsNotGiven":
        """Return what is said of a compensation."""
        return cls(
            lambda name: make_message(_NOT_CORRECTED, name=name, cure=_CURE), _in_capitals(without_motion)
        )

    def with_findings(self, read: ReadProgram, result: ProgramResult) -> ProgramResult:
        """Return a result with a finding for each routine that the program calls and no given file has."""
        names = brand_named(read.program.brand).routine_names
        calls = names.find_calls(read.data) if names is not None else ()
        first_calls: dict[str, CalledRoutine] = {}
        for call in calls:
            if not (moves_no_robot(call.name) or self._is_without_motion(call.name)):
                first_calls.setdefault(call.name.upper(), call)
        if not first_calls:
            return result
        given = _names_given(read.source, read.program.brand, read.data)
        own = frozenset[str]() if names is None or names.calls_itself else names.find_routines(read.data)
        found = [
            PointFinding(
                call.line, call.name, "CALL", self.angle_rad, math.nan, math.nan, self.write_text(call.name)
            )
            for name, call in first_calls.items()
            if not _is_given(name, call, given, own)
        ]
        return with_further_findings(result, found)

    def _is_without_motion(self, name: str) -> bool:
        return any(fnmatchcase(name.upper(), pattern) for pattern in self.without_motion)


def _in_capitals(patterns: Sequence[str]) -> tuple[str, ...]:
    return tuple(pattern.upper() for pattern in patterns)


def _is_given(name: str, call: CalledRoutine, given: frozenset[str], own: frozenset[str]) -> bool:
    """Return whether a call's routine is given; a computed name means none of ``own``."""
    if not call.pattern:
        return name in given
    return any(fnmatchcase(each, call.pattern) for each in given - own)


def _names_given(source: ProgramSource, brand: str, data: bytes) -> frozenset[str]:
    """Return the routines of all files of the brand that were given with one, in capitals; its own counts, too."""
    names = brand_named(brand).routine_names
    assert names is not None
    siblings = source.siblings
    if siblings is None:
        return names.find_routines(data)
    if brand not in siblings.routines:
        siblings.routines[brand] = frozenset[str]().union(
            *(names.find_routines(each) for each in _bytes_of(siblings.sources, brand))
        )
    return siblings.routines[brand]


def _bytes_of(sources: Sequence[ProgramSource], brand: str) -> list[bytes]:
    found = []
    for source in sources:
        try:
            data = read_bytes(source.path)
        except ProgramFileError:
            continue  # it is refused when its turn comes
        owner = brand_of(str(source.path), data)
        if owner is not None and owner.brand == brand:
            found.append(data)
    return found
