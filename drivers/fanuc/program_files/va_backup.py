"""A folder of .VA files as one controller: frames, tools, position registers, mastering."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.backup_file import read_backup_file
from cellcal.drivers.fanuc.program_files.va_mastering import GroupMastering, read_mastering
from cellcal.drivers.fanuc.program_files.va_positions import VaPosition
from cellcal.drivers.fanuc.program_files.va_spots import damaged_file_error, parse_integer
from cellcal.drivers.fanuc.program_files.va_text import MAX_FILE_BYTES, VaFile
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import ProgramFrames

FRAMES, REGISTERS, MASTERING, DRIVES = "SYSFRAME.VA", "POSREG.VA", "SYSMAST.VA", "SYMOTN.VA"
BACKUP_FILES = (FRAMES, REGISTERS, MASTERING, DRIVES)
_IDENTITY = Pose((0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class FanucBackup:
    """Contents of a backup. Keys: (group, number); poses in SI, user frames seen from the group's world frame."""

    folder: str
    files: Mapping[str, VaFile]  # by upper-case name
    frame_positions: Mapping[tuple[int, int], VaPosition] = field(default_factory=dict)
    tool_positions: Mapping[tuple[int, int], VaPosition] = field(default_factory=dict)
    selected_frames: Mapping[int, int] = field(default_factory=dict)  # $MNUFRAMENUM by group
    selected_tools: Mapping[int, int] = field(default_factory=dict)
    registers: Mapping[tuple[int, int], VaPosition] = field(default_factory=dict)
    mastering: Mapping[int, GroupMastering] = field(default_factory=dict)

    @property
    def missing_files(self) -> tuple[str, ...]:
        """Return the files that would tell more and are not there."""
        return tuple(name for name in BACKUP_FILES if name not in self.files)

    @property
    def user_frames(self) -> Mapping[tuple[int, int], Pose]:
        """Return ``world_frame`` of every user frame that was stored."""
        return _stored_poses(self.frame_positions)

    @property
    def tool_poses(self) -> Mapping[tuple[int, int], Pose]:
        """Return ``flange_tip`` of every tool that was stored."""
        return _stored_poses(self.tool_positions)

    def group_frames(self, group: int = 1) -> ProgramFrames:
        """Return one group's frames and tools by the number that programs write; 0 is none."""
        return ProgramFrames(
            base_frame={"0": _IDENTITY} | {str(n): p for (g, n), p in self.user_frames.items() if g == group},
            flange_tip={"0": _IDENTITY} | {str(n): p for (g, n), p in self.tool_poses.items() if g == group},
        )

    def list_findings(self) -> tuple[str, ...]:
        """Return what a person must know, as sentences."""
        absent = tuple(make_message("{name} is not in the folder", name=name) for name in self.missing_files)
        return (*absent, *(finding for group in self.mastering.values() for finding in group.findings))


def read_backup(folder: str | Path) -> FanucBackup:
    """Read the files of a controller's backup that hold frames, tools, registers and mastering.

    A file that is not there leaves its part empty and is named in ``missing_files``.

    Raises
    ------
    ProgramFileError
        There is none of them, a file is damaged, or it cannot be read.
    """
    files = {
        name: VaFile.from_bytes(path.name, read_backup_file(path, MAX_FILE_BYTES))
        for name, path in _find_files(Path(folder)).items()
    }
    return assemble_backup(str(folder), files)


def assemble_backup(label: str, files: Mapping[str, VaFile]) -> FanucBackup:
    """Read what .VA files tell, by their upper-case names; ``label`` names where they come from.

    Raises
    ------
    ProgramFileError
        A file is damaged.
    """
    frames, registers, master = (files.get(name) for name in (FRAMES, REGISTERS, MASTERING))
    return FanucBackup(
        folder=label,
        files=files,
        frame_positions={} if frames is None else _numbered_positions(frames, "$MNUFRAME"),
        tool_positions={} if frames is None else _numbered_positions(frames, "$MNUTOOL"),
        selected_frames={} if frames is None else _selected_numbers(frames, "$MNUFRAMENUM"),
        selected_tools={} if frames is None else _selected_numbers(frames, "$MNUTOOLNUM"),
        registers={} if registers is None else _numbered_positions(registers, "$POSREG"),
        mastering={} if master is None else read_mastering(master, files.get(DRIVES)),
    )


def with_registers(backup: FanucBackup, data: bytes) -> FanucBackup:
    """Return a backup with another POSREG.VA, which is read.

    Raises
    ------
    ProgramFileError
        It is damaged.
    """
    file = VaFile.from_bytes(REGISTERS, data)
    return replace(
        backup, files={**backup.files, REGISTERS: file}, registers=_numbered_positions(file, "$POSREG")
    )


def _find_files(folder: Path) -> dict[str, Path]:
    try:
        entries = sorted(entry for entry in folder.iterdir() if entry.name.upper() in BACKUP_FILES)
    except OSError as error:
        raise ProgramFileError(
            str(folder),
            make_message("the folder cannot be read: {strerror}.", strerror=error.strerror),
            remedy="Give the folder that holds the controller's .VA files, unpacked.",
        ) from error
    found: dict[str, Path] = {}
    for entry in entries:
        if entry.name.upper() in found:
            raise ProgramFileError(
                str(folder),
                make_message(
                    "{found_name} and {entry_name} are the same file to a controller.",
                    found_name=found[entry.name.upper()].name,
                    entry_name=entry.name,
                ),
                remedy="Leave one backup in the folder.",
            )
        found[entry.name.upper()] = entry
    if not found:
        raise ProgramFileError(
            str(folder),
            make_message("none of {backup_files} is there.", backup_files=", ".join(BACKUP_FILES)),
            remedy="Save the system variables as ASCII (.VA), or read MD: by FTP; .SV files cannot be read.",
        )
    return found


def _numbered_positions(file: VaFile, name: str) -> dict[tuple[int, int], VaPosition]:
    """Return the positions of a two-dimensional array by (group, number)."""
    found, variable = {}, file.read_variable(name)
    if not variable.positions:
        raise damaged_file_error(
            file.name, variable.line, make_message("{name} holds no positions.", name=name)
        )
    for path, position in variable.positions.items():
        index = path[len(name) + 1 : -1].split(",")
        if len(index) != 2:
            raise damaged_file_error(
                file.name,
                position.line,
                make_message("{name} is not numbered by group and number.", name=name),
            )
        found[int(index[0]), int(index[1])] = position
    return found


def _selected_numbers(file: VaFile, name: str) -> dict[int, int]:
    if not file.has_variable(name):
        return {}
    variable = file.read_variable(name)
    spots = {path: spot for path, spot in variable.values.items() if spot.is_initialised}
    return {
        int(path[len(name) + 1 : -1] or 1): parse_integer(file.name, spot) for path, spot in spots.items()
    }


def _stored_poses(positions: Mapping[tuple[int, int], VaPosition]) -> dict[tuple[int, int], Pose]:
    pairs: Iterable[tuple[tuple[int, int], Pose | None]] = ((k, p.to_pose()) for k, p in positions.items())
    return {key: pose for key, pose in pairs if pose is not None}
