"""``cellcal mastering record`` and ``watch``: FANUC controllers by their files, over FTP or from a backup."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin
    from cellcal.service.engineering.controller_files.nightly_watch import WatchedController
    from cellcal.service.engineering.controller_files.record_from_files import FilesRecord, FilesRecords
    from cellcal.service.engineering.controller_files.sliding_axes import SlidingAxis
    from cellcal.service.engineering.controller_files.stored_records import StoredRecord

RECORDS = Path("mastering_records")
RecordFolder = Annotated[
    Path, Parameter(name="--records", help="Folder of the signed records and of the key that signs them.")
]
Json = Annotated[
    bool, Parameter(name="--json", negative=(), help="Print one JSON object on standard output.")
]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class FtpOptions:
    """How a controller's FTP server is asked; it is only read, nothing is ever written."""

    user: Annotated[str, Parameter(name="--user", help="FTP user; most controllers let anonymous read.")] = (
        "anonymous"
    )
    password_file: Annotated[
        Path | None, Parameter(name="--password-file", help="File whose first line is the FTP password.")
    ] = None
    timeout_s: Annotated[
        float, Parameter(name="--timeout", help="Seconds that a controller may take for an answer.")
    ] = 10.0
    programs: Annotated[
        bool,
        Parameter(name="--programs", help="Read the programs as well, so that a changed one is noticed."),
    ] = True


_USUAL = FtpOptions()


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class RobotIdentity:
    """Facts about a robot that the files may leave open."""

    group: Annotated[
        int | None, Parameter(name="--group", help="Motion group, where not every one shall have a record.")
    ] = None
    model: Annotated[
        str | None,
        Parameter(
            name="--model", help="Name in `cellcal models`, where the controller's own is not known there."
        ),
    ] = None
    serial: Annotated[str | None, Parameter(name="--serial", help="F number, where no file tells it.")] = None


_BY_ITS_FILES = RobotIdentity()


def record(
    source: str,
    /,
    *,
    records: RecordFolder = RECORDS,
    whose: RobotIdentity = _BY_ITS_FILES,
    ftp: FtpOptions = _USUAL,
    as_json: Json = False,
) -> int:
    """Make mastering records of a FANUC controller's groups from its files: no option, no program, nothing written.

    Exit code 0: every group whose axes turn has a record, signed; 4: one of them was refused.

    Parameters
    ----------
    source
        The controller's address (HOST or HOST:PORT), or a folder that holds a backup of it.
    whose
        Which robot of the controller it is.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json, say_while_waiting
    from cellcal.service.engineering.controller_files.copied_mastering import with_copies_named
    from cellcal.service.engineering.controller_files.nightly_watch import confirm_controller, read_controller
    from cellcal.service.engineering.controller_files.record_from_files import make_records
    from cellcal.service.engineering.controller_files.stored_records import store_record
    from cellcal.service.exit_codes import ExitCode

    with say_while_waiting(f"reading the files of {source}"):
        files = read_controller(source, _login(ftp), with_programs=ftp.programs)
        made = with_copies_named(
            make_records(files, group=whose.group, model=whose.model, serial=whose.serial), records
        )
        if files.is_live:
            confirm_controller(source, _login(ftp), files)
    stored = [store_record(records, each, files) for each in made.records]
    if as_json:
        print_json(_records_document(made, stored))
    for done, stored_record in zip(made.records, stored, strict=True):
        _print_record(done)
        STDERR_CONSOLE.print(f"record: {stored_record.path}", markup=False, soft_wrap=True)
        STDERR_CONSOLE.print(
            f"Signed. Check it with: cellcal verify {stored_record.path} --key {stored_record.public_key}",
            markup=False,
            soft_wrap=True,
        )
    for refused in made.refused:
        STDERR_CONSOLE.print(f"NO record: {refused}", markup=False, soft_wrap=True)
    STDERR_CONSOLE.print(
        f"Compare every night: cellcal mastering watch {source} --records {records}",
        markup=False,
        soft_wrap=True,
    )
    return ExitCode.REFUSED if made.refused else ExitCode.PASS


def watch(
    *sources: str,
    records: RecordFolder = RECORDS,
    addresses_file: Annotated[
        Path | None,
        Parameter(name="--file", help="A file with one address or folder a line; # begins a remark."),
    ] = None,
    ftp: FtpOptions = _USUAL,
    as_json: Json = False,
) -> int:
    """Compare FANUC controllers with their newest records, all at once; one line for each. For a nightly timer.

    Exit code 0: all as recorded; 3: a position is lost, or something changed; 5: a controller was not read;
    4: one has no record yet, or a file of the record was missing. The gravest counts.

    Parameters
    ----------
    sources
        Addresses of controllers, or folders with backups of them.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.controller_files.nightly_watch import watch_controllers
    from cellcal.service.exit_codes import gravest_exit_code

    addresses = (*sources, *_addresses_in(addresses_file))
    if not addresses:
        _refuse_nothing()
    found = watch_controllers(
        addresses,
        records,
        _login(ftp),
        with_programs=ftp.programs,
        report=lambda each: STDERR_CONSOLE.print(_line_of(each), markup=False, soft_wrap=True),
    )
    if as_json:
        print_json({"robots": [_watched_document(each) for each in found]})
    return gravest_exit_code(each.exit_code for each in found)


def _login(options: FtpOptions) -> "FtpLogin":
    from math import isfinite

    from cellcal.calibration.documents.plain_files import read_plain_text
    from cellcal.calibration.errors import CellError
    from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin

    if not isfinite(options.timeout_s) or not 0.1 <= options.timeout_s <= 600.0:
        raise CellError("--timeout is from 0.1 to 600 seconds.", code="usage")
    password = ""
    if options.password_file is not None:
        password = (read_plain_text(options.password_file).splitlines() or [""])[0]
    if any(mark in options.user + password for mark in "\r\n\0"):
        raise CellError("a user or password holds no line ends.", code="usage")
    return FtpLogin(options.user, password, options.timeout_s, max(60.0, 12 * options.timeout_s))


def _addresses_in(file: Path | None) -> tuple[str, ...]:
    from cellcal.calibration.documents.plain_files import read_plain_text

    if file is None:
        return ()
    lines = (line.partition("#")[0].strip() for line in read_plain_text(file).splitlines())
    return tuple(line for line in lines if line)


def _refuse_nothing() -> None:
    from cellcal.calibration.errors import CellError

    raise CellError(
        "no controller was named.", remedy="Give addresses, or a file of them with --file.", code="usage"
    )


def _line_of(each: "WatchedController") -> str:
    name = f"{each.address} {each.serial}".strip()
    return f"{name}  {each.state.upper()}  {each.sentence}"


def _print_record(done: "FilesRecord") -> None:
    import math

    from cellcal.service.cli.printing import STDERR_CONSOLE, PlainTable

    title = f"{done.device}: {done.robot or 'robot'} {done.record.robot_serial}, group {done.group}"
    table = PlainTable(
        "axis", "machine pulse", "master count", "mastered", "angle (deg)", "shown (deg)", title=title
    )
    for row in done.rows:
        table.add_row(
            f"J{row.axis}",
            "-" if row.pulse is None else str(row.pulse),
            str(row.count_at_zero),
            "yes" if row.mastered else "no",
            "-" if row.angle_rad is None else f"{math.degrees(row.angle_rad):.4f}",
            "-" if row.shown_deg is None else f"{row.shown_deg:.2f}",
        )
    STDERR_CONSOLE.print(table)
    for heading, lines in (
        ("Checked", done.checked),
        ("NOT checked", done.not_checked),
        ("Note", done.findings),
    ):
        for line in lines:
            STDERR_CONSOLE.print(f"{heading}: {line}.", markup=False, soft_wrap=True)


def _records_document(made: "FilesRecords", stored: "Sequence[StoredRecord]") -> dict[str, object]:
    documents = [
        _as_document(done) | {"file": str(stored_record.path), "public_key": stored_record.public_key}
        for done, stored_record in zip(made.records, stored, strict=True)
    ]
    refused = [{"message": error.message, "remedy": error.remedy} for error in made.refused]
    return {"records": documents, "refused": refused}


def _as_document(done: "FilesRecord") -> dict[str, object]:
    rows = [
        {
            "axis": row.axis,
            "machine_pulse": row.pulse,
            "master_count": row.count_at_zero,
            "mastered": row.mastered,
            "angle_rad": row.angle_rad,
            "shown_deg": row.shown_deg,
        }
        for row in done.rows
    ]
    return {
        "device": done.device,
        "serial": done.record.robot_serial,
        "model": done.record.model,
        "robot": done.robot,
        "group": done.group,
        "axes": rows,
        "sha256": done.record.sha256,
        "checked": list(done.checked),
        "not_checked": list(done.not_checked),
        "findings": list(done.findings),
        "sliding_axes": [_sliding_document(each) for each in done.sliding],
    }


def _sliding_document(each: "SlidingAxis") -> dict[str, object]:
    return {
        "group": each.group,
        "axis": each.axis,
        "master_count": each.count_at_zero,
        "machine_pulse": each.pulse,
        "counted_mm": each.counted_mm,
        "shown_mm": each.shown_mm,
    }


def _watched_document(each: "WatchedController") -> dict[str, object]:
    changes = [{"kind": str(change.kind), "text": change.text} for change in each.changes]
    document: dict[str, object] = {
        "address": each.address,
        "serial": each.serial,
        "state": str(each.state),
    }
    document |= {"compared_with": each.compared_with, "not_compared": [*each.not_compared, *each.left_out]}
    return document | {"changes": changes, "error": each.error}
