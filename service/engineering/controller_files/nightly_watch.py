"""``cellcal mastering watch``: many controllers at once, one answer each; one that fails does not stop the others."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.controller_files.controller_address import parse_address
from cellcal.drivers.fanuc.controller_files.controller_files import ControllerFiles, read_controller_files
from cellcal.drivers.fanuc.controller_files.file_sources import FileSource
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin, FtpSource
from cellcal.drivers.fanuc.program_files.va_backup import MASTERING
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.controller_files.backup_folder import open_backup_folder, refuse_file
from cellcal.service.engineering.controller_files.copied_mastering import describe_copied_mastering
from cellcal.service.engineering.controller_files.file_change import ChangeKind, FileChange
from cellcal.service.engineering.controller_files.file_changes import (
    compare_files,
    describe_uncompared_angles,
)
from cellcal.service.engineering.controller_files.other_axes import find_other_axes, name_axis
from cellcal.service.engineering.controller_files.record_checks import position_alarms
from cellcal.service.engineering.controller_files.second_readings import confirm_mastering
from cellcal.service.engineering.controller_files.stored_records import StoredRecord, list_records
from cellcal.service.engineering.controller_files.uncompared_parts import (
    list_absent_parts,
    list_unread_programs,
)
from cellcal.service.exit_codes import ExitCode

AT_ONCE = 16


class WatchState(StrEnum):
    """The state in which one robot was found."""

    UNCHANGED = "unchanged"
    CHANGED = "changed"
    ANOTHER = "another robot"
    LOST = "position lost"
    NOT_COMPARED = "not compared"
    NO_RECORD = "no record"
    FAILED = "not read"


@dataclass(frozen=True, slots=True)
class WatchedController:
    """The result of the watch for one robot."""

    address: str
    state: WatchState
    serial: str = ""
    compared_with: str = ""
    changes: tuple[FileChange, ...] = ()
    not_compared: tuple[str, ...] = ()  # axes that the record does not contain
    left_out: tuple[str, ...] = ()  # what could not be compared this time
    error: str = ""
    error_code: str = ""

    @property
    def exit_code(self) -> ExitCode:
        """Return what the shell gets to know of this robot."""
        return _EXIT_CODES[self.state]

    @property
    def sentence(self) -> str:
        """Say it in one line, without the address."""
        if self.state is WatchState.FAILED:
            return self.error
        if self.state is WatchState.NO_RECORD:
            return f"there is no record yet: cellcal mastering record {self.address}"
        found = "; ".join(f"{change.kind}: {change.text}" for change in self.changes)
        if self.state in (WatchState.UNCHANGED, WatchState.NOT_COMPARED):
            found = f"as in the record of {self.compared_with}"
        if self.not_compared:
            axes = ", ".join(self.not_compared)
            found += (
                f"; not compared, since the record was taken before they were stored: {axes}. Record again."
            )
        if self.left_out:
            found += f"; not compared: {', '.join(self.left_out)}"
        return found


_EXIT_CODES = {
    WatchState.UNCHANGED: ExitCode.PASS,
    WatchState.CHANGED: ExitCode.OUT_OF_TOLERANCE,
    WatchState.ANOTHER: ExitCode.OUT_OF_TOLERANCE,
    WatchState.LOST: ExitCode.OUT_OF_TOLERANCE,
    WatchState.NOT_COMPARED: ExitCode.REFUSED,
    WatchState.NO_RECORD: ExitCode.REFUSED,
    WatchState.FAILED: ExitCode.UNREACHABLE,
}
_CHANGED = (WatchState.CHANGED, WatchState.ANOTHER, WatchState.LOST)


@contextmanager
def open_source(text: str, login: FtpLogin) -> Iterator[FileSource]:
    """Open a folder that is there, or else the controller at an address."""
    if Path(text).is_dir():
        yield open_backup_folder(Path(text))
        return
    refuse_file(Path(text))
    with FtpSource(parse_address(text), login) as source:
        yield source


def read_controller(text: str, login: FtpLogin, *, with_programs: bool = True) -> ControllerFiles:
    """Read the files of a controller, or of a folder with its backup."""
    with open_source(text, login) as source:
        try:
            return read_controller_files(source, with_programs=with_programs)
        except ProgramFileError as error:
            error.message = make_message(
                "{device}: {error_message}", device=source.device, error_message=error.message
            )
            raise


def confirm_controller(text: str, login: FtpLogin, files: ControllerFiles) -> None:
    """Read the mastering of a controller again; refuse where it is another one now (``ControllerRecordError``)."""
    with open_source(text, login) as source:
        confirm_mastering(files, source)


def watch_controllers(
    addresses: Sequence[str],
    records: Path,
    login: FtpLogin,
    *,
    with_programs: bool = True,
    report: Callable[[WatchedController], None] = lambda _: None,
) -> tuple[WatchedController, ...]:
    """Compare every controller with its newest record; ``report`` is called as answers arrive.

    Raises
    ------
    RecordFileError
        The records cannot be read: nothing could be compared with.
    """
    stored = list_records(records)

    def look_at(address: str) -> WatchedController:
        try:
            return _look_twice(
                address,
                stored,
                lambda: read_controller(address, login, with_programs=with_programs),
            )
        except CellError as error:
            return WatchedController(address, WatchState.FAILED, error=str(error), error_code=error.code)
        except Exception as error:  # noqa: BLE001  a fault of ours with one robot must not hide the others
            text = f"{address}: an internal fault, {type(error).__name__}: {error}. Report this."
            return WatchedController(address, WatchState.FAILED, error=text, error_code="internal")

    unique = tuple(dict.fromkeys(addresses))
    found: dict[str, WatchedController] = {}
    with ThreadPoolExecutor(max_workers=min(AT_ONCE, max(1, len(unique)))) as pool:
        waiting = {pool.submit(look_at, address): address for address in unique}
        for done in as_completed(waiting):
            found[waiting[done]] = done.result()
            report(found[waiting[done]])
    return tuple(found[address] for address in unique)


def _look_twice(
    address: str, stored: Sequence[StoredRecord], read: Callable[[], ControllerFiles]
) -> WatchedController:
    """Compare a controller with its records; what differs counts once a second reading says the same."""
    files = read()
    found = compare_with_records(address, files, stored)
    if found.state not in _CHANGED or not files.is_live:
        return found
    again = compare_with_records(address, read(), stored)
    if (again.state, _lasting(again.changes)) == (found.state, _lasting(found.changes)):
        return found
    error = make_message(
        "{device}: two readings, one right after the other, contradict each other: {first}; and then: {second}. "
        "Look at the network between, and whether something else answers at its address; then read once more.",
        device=files.device,
        first=found.sentence,
        second=again.sentence,
    )
    return WatchedController(
        address, WatchState.FAILED, found.serial, error=error, error_code="device.protocol"
    )


def _lasting(changes: Sequence[FileChange]) -> set[tuple[ChangeKind, str]]:
    """Return what two readings must agree on: where the arm stands may differ, that it contradicts may not."""
    return {
        (change.kind, "" if change.kind is ChangeKind.CONTRADICTION else change.text) for change in changes
    }


def compare_with_records(
    address: str, files: ControllerFiles, stored: Sequence[StoredRecord]
) -> WatchedController:
    """Compare the files of one controller with the records of its groups."""
    ours = _records_of(files, stored)
    if not ours:
        error = _unusable_files(files)
        state = WatchState.FAILED if error else WatchState.NO_RECORD
        return WatchedController(
            address, state, files.serial, error=error, error_code="device" if error else ""
        )
    if MASTERING in files.missing and not position_alarms(files):
        error = _without_mastering(files)
        return WatchedController(address, WatchState.FAILED, files.serial, error=error, error_code="device")
    changes: list[FileChange] = []
    compared_with, not_compared, left_out, absent_parts = "", set[str](), list[str](), list[str]()
    groups = {each.controller.group for each in ours}
    for group in sorted(groups):
        *earlier, last = [each for each in ours if each.controller.group == group]
        changes += compare_files(files, last, earlier, groups)
        changes += _find_copies(files, group, stored)
        compared_with = max(compared_with, last.day)
        absent_parts += list_absent_parts(files, last)
        left_out += [describe_uncompared_angles(files, last), *list_unread_programs(files)]
        if last.controller.other_axes is None:
            others = find_other_axes(files, group)
            not_compared |= {name for name in others if int(name.partition(".")[0]) not in groups - {group}}
    unique = tuple(dict.fromkeys(changes))
    state = WatchState.NOT_COMPARED if absent_parts else WatchState.UNCHANGED
    state = WatchState.CHANGED if unique else state
    if any(change.kind is ChangeKind.LOSS for change in unique):
        state = WatchState.LOST
    if any(change.kind is ChangeKind.OTHER_ROBOT for change in unique):
        state = WatchState.ANOTHER  # whether it has lost anything is no question of the recorded one
    axes = tuple(map(name_axis, sorted(not_compared)))
    angles = tuple(dict.fromkeys(filter(None, (*absent_parts, *left_out))))
    return WatchedController(address, state, files.serial, compared_with, unique, axes, angles)


def _unusable_files(files: ControllerFiles) -> str:
    """Return why files tell no robot that could have a record; "" where they are those of one."""
    if not files.read_names:
        return (
            f"{files.device}: none of its files can be read. See on the pendant whether MD: lists AXIS.DG and "
            f"{MASTERING}, and whether reading needs a password."
        )
    contradictions = "; ".join(files.list_contradictions())
    return f"{files.device}: {contradictions}. Read once more." if contradictions else ""


def _without_mastering(files: ControllerFiles) -> str:
    if MASTERING in files.not_given:
        reason = files.not_given[MASTERING]
        return f"{files.device}: the controller refuses {MASTERING} for now ({reason}). Read once more."
    return (
        f"{files.device}: there is no {MASTERING}, which holds the mastering. Read once more, with all files."
    )


def _find_copies(files: ControllerFiles, group: int, stored: Sequence[StoredRecord]) -> list[FileChange]:
    mastering = files.variables.mastering.get(group)
    if mastering is None:
        return []
    texts = describe_copied_mastering(mastering.counts_at_zero, files.serial, files.device, stored)
    return [FileChange(ChangeKind.COPIED, text) for text in texts]


def _records_of(files: ControllerFiles, stored: Sequence[StoredRecord]) -> list[StoredRecord]:
    """Return the records of a controller: by address, else by its number where no two addresses share that.

    Controllers whose number was never set share one.
    """
    here = [each for each in stored if each.controller.address == files.device]
    ours = [each for each in here if each.record.robot_serial == files.serial]
    if ours or here:
        return ours or here
    alike = [each for each in stored if files.serial and each.record.robot_serial == files.serial]
    return alike if len({each.controller.address for each in alike}) == 1 else []
