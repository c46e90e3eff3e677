"""What a brand gives to everything that reads its programs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.called_routines import RoutineNames
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.file_declarations import ExternalUses, FileDeclarations
from cellcal.drivers.programs.positions import PositionChange, ProgramFile


class ConfigurationRule(Protocol):
    """A maker's distinction of the postures that reach one pose: flags and turn numbers."""

    def matches_postures(
        self, model: RobotModel, joints: Array, texts: Sequence[str], *, turns: bool = True
    ) -> NDArray[np.bool_]:
        """Return (N,): whether postures (N, n) [rad] are what the texts say; ``turns=False`` looks at flags only.

        A text without a statement agrees with every posture.
        """
        ...

    def keeps_posture(self, model: RobotModel, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Return (N,): whether a point that is taken to postures (N, n) [rad] needs no other posture than it says.

        What an arm passes through without turning over may have changed: turn numbers, and quadrants of axes.
        """
        ...

    def write_configurations(self, model: RobotModel, joints: Array, like: Sequence[str]) -> tuple[str, ...]:
        """Return the texts that say these postures (N, n), in the spelling of the N old texts."""
        ...


@runtime_checkable
class SharedConfigurations(Protocol):
    """The rule of a maker whose files state a configuration once for many positions, none of which takes another."""

    def refuses_change(self, old: str, new: str) -> str:
        """Return why a position cannot take another text."""
        ...


@dataclass(frozen=True, slots=True)
class ProgramBrand:
    """One brand's program files."""

    brand: str
    suffixes: tuple[str, ...]  # lower case, with the dot: (".ls",)
    read: Callable[[str, bytes], ProgramFile]  # the file's name for messages, its bytes; ProgramFileError
    configurations: (
        ConfigurationRule | None
    )  # None: joints are stored beside the pose, or poses name no posture
    writes_program: Callable[[bytes], bool] = lambda _: (
        True
    )  # a suffix shared with other files: is it a program?
    tells: bool = False  # whether its programs are `Telling`
    says: Callable[[str, bytes], FileDeclarations | None] = lambda *_: (
        None
    )  # what a file says, where that is quicker than reading
    beside: tuple[PurePath, ...] = ()  # lists of its controller in folders above programs, which say more
    routine_names: RoutineNames | None = None  # what its files call, and the routines that they have
    together: "ProgramBatch | None" = None  # where many at once are quicker than one after another


class DeclaringProgram(ProgramFile, Protocol):
    """A program whose positions other files of its robot use, or that uses theirs."""

    @property
    def declarations(self) -> FileDeclarations:
        """Return what counts for other files."""
        ...

    def with_external_uses(self, external_uses: ExternalUses) -> "DeclaringProgram":
        """Return the program with what the other files say."""
        ...


class ProgramBatch(Protocol):
    """A brand's functions to read and change many programs at once."""

    def read_files(self, files: Sequence[tuple[str, bytes]]) -> Sequence[ProgramFile | ProgramFileError]:
        """Return programs by their names and bytes; what is wrong with one stands at its place."""
        ...

    def change_files(
        self, programs: Sequence[ProgramFile], changes: Sequence[PositionChange]
    ) -> Sequence[ProgramFile]:
        """Return programs with their changes, as `ProgramFile.changed` of each."""
        ...
