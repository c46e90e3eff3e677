"""Sources of readings without a connected device: an operator, or a file that another program writes."""

import asyncio
import stat
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import DeviceTimeoutError, RefusedError, UnreachableError
from cellcal.drivers.file_import.number_text import ColumnLayout, TextError, TextRow, parse_typed, rows_of
from cellcal.drivers.interfaces import Operator, Question
from cellcal.drivers.wire.deadline import answer_deadline
from cellcal.drivers.wire.worker import CallWorker

MOST_BYTES = 20_000_000
_POLL_S = 0.1
_TRIES = 3
_UTF_16 = (b"\xff\xfe", b"\xfe\xff")


class RowSource(Protocol):
    """Gives one reading for each call."""

    async def next_row(self) -> TextRow: ...
    async def check_source(self) -> None:
        """Raise a DeviceError when no reading can be had."""
        ...

    def close(self) -> None: ...


class TypedRows:
    """Asks the technician for each reading."""

    def __init__(self, device: str, operator: Operator | None, text: str, unit: str, count: int) -> None:
        self._device, self._operator, self._text, self._unit, self._count = (
            device,
            operator,
            text,
            unit,
            count,
        )

    async def next_row(self) -> TextRow:
        """Ask until the answer is a reading, three times at most."""
        if self._operator is None:
            raise RefusedError(
                self._device, "there is no operator to enter a reading.", remedy="Run it by hand."
            )
        text = self._text
        for _ in range(_TRIES):
            question = Question(f"reading:{self._device}", text, self._unit, self._count)
            answer = await self._operator.ask_question(question)
            try:
                return TextRow(
                    parse_typed(answer.value, self._count), 0, f"{answer.value.strip()} ({answer.who})"
                )
            except TextError as fault:
                text = make_message("{fault}. {text}", fault=fault, text=self._text)
        raise RefusedError(
            self._device,
            make_message("no reading was given: {text}", text=text),
            remedy="Read the instrument again, then resume.",
        )

    async def check_source(self) -> None:
        return

    def close(self) -> None:
        return


@dataclass(frozen=True, slots=True)
class FileOptions:
    """The file, its layout, and the time to wait for its next row."""

    path: Path
    layout: ColumnLayout
    wait_s: float
    deadline_s: float
    first_row: int | None = None


class _ReadingFile:
    """Reads a file that another program may be writing, and holds that it only ever grows."""

    def __init__(self, device: str, options: FileOptions) -> None:
        self.device, self.options = device, options
        self._worker: CallWorker | None = None
        self._before = b""

    async def read_content(self) -> bytes:
        """Return the whole file; nothing where there is none yet.

        Raises
        ------
        RefusedError
            The file is no plain text, too large, or no longer begins with what was read before.
        """
        if self._worker is None:
            self._worker = CallWorker(f"file {self.device}")
        try:
            async with answer_deadline(
                self.device, self.options.deadline_s, make_message("reading {name}", name=self.options.path)
            ):
                found = await self._worker.run_call(lambda: _read_file(self.options.path))
        except DeviceTimeoutError:
            self.close()
            raise
        except OSError as error:
            raise UnreachableError(
                self.device,
                make_message(
                    "{path} cannot be read: {reason}.", path=self.options.path, reason=error.strerror or error
                ),
                remedy="Check the path in cell.toml, the share and its permissions.",
            ) from error
        except ValueError as error:
            raise self.file_error(str(error), "Save readings as a text file (CSV, UTF-8).") from error
        if not found.startswith(self._before):
            raise self.file_error(
                _first_change(self._before, found),
                "Readings already used have changed: restore the file, or begin the measurement anew.",
            )
        self._before = found
        return found

    def parse_rows(self, content: bytes) -> list[TextRow]:
        """Return the readings of the lines that have ended."""
        complete = content[: content.rfind(b"\n") + 1]
        try:
            return rows_of(_decode_text(complete), self.options.layout)
        except TextError as fault:
            raise self.file_error(
                str(fault), "Correct the row in the instrument's program, or its layout."
            ) from fault

    def file_error(self, message: str, remedy: str) -> RefusedError:
        return RefusedError(
            self.device,
            make_message("{path_name}: {message}.", path_name=self.options.path.name, message=message),
            remedy=remedy,
        )

    def close(self) -> None:
        if self._worker is not None:
            self._worker.stop()
            self._worker = None


class GrowingFile:
    """Takes the row that was written after the question; the instrument's program appends one for each shot."""

    def __init__(self, device: str, options: FileOptions) -> None:
        self._file = _ReadingFile(device, options)

    async def check_source(self) -> None:
        """See that the file can be read, or that its folder is there to write it to."""
        if not self._file.options.path.parent.is_dir():
            raise UnreachableError(
                self._file.device,
                make_message("there is no folder {path}.", path=self._file.options.path.parent),
                remedy="Check the path in cell.toml.",
            )
        self._file.parse_rows(await self._file.read_content())

    async def next_row(self) -> TextRow:
        """Wait for one new row; what stood there before, also without its line end, is not new."""
        content = await self._file.read_content()
        earlier_rows = len(self._file.parse_rows(content)) + bool(_last_line(content).strip())
        ends_s = time.monotonic() + self._file.options.wait_s
        while time.monotonic() < ends_s:
            await asyncio.sleep(_POLL_S)
            content = await self._file.read_content()
            new = self._file.parse_rows(content)[earlier_rows:]
            if len(new) == 1:
                return new[0]
            if new:
                raise self._file.file_error(
                    make_message(
                        "{count} rows were written for one reading (lines {first} to {last})",
                        count=len(new),
                        first=new[0].line,
                        last=new[-1].line,
                    ),
                    "One shot for each question: resume, and shoot once when asked.",
                )
        raise self._late_row_error(content, earlier_rows)

    def close(self) -> None:
        self._file.close()

    def _late_row_error(self, content: bytes, earlier_rows: int) -> DeviceTimeoutError:
        wait_s = self._file.options.wait_s
        message = make_message(
            "no new row in {name} within {wait_s:g} s; it has {earlier_rows} older ones.",
            name=self._file.options.path.name,
            wait_s=wait_s,
            earlier_rows=earlier_rows,
        )
        if _last_line(content).strip():
            half_written = "Its last line has no line end yet, so it may be half written."
            message = join_messages(" ", (message, half_written))
        return DeviceTimeoutError(self._file.device, message, remedy="Resume, and shoot after the question.")


class WholeFile:
    """Takes row after row of a file that was measured before; the operator names the first row."""

    def __init__(self, device: str, options: FileOptions, operator: Operator | None) -> None:
        self._file, self._operator = _ReadingFile(device, options), operator
        self._next: int | None = options.first_row

    async def check_source(self) -> None:
        if not self._file.parse_rows(await self._read_whole()):
            raise self._file.file_error("it holds no readings", "Check the file and its layout in cell.toml.")

    async def next_row(self) -> TextRow:
        """Return the next row. Raises RefusedError behind the last one."""
        rows = self._file.parse_rows(await self._read_whole())
        if self._next is None:
            self._next = await self._ask_first_row(len(rows))
        if not 1 <= self._next <= len(rows):
            raise self._file.file_error(
                make_message("row {row} is asked for, it has {count}", row=self._next, count=len(rows)),
                "See that the file holds a row for every pose, in their order.",
            )
        row = rows[self._next - 1]
        self._next += 1
        return row

    def close(self) -> None:
        self._file.close()

    async def _read_whole(self) -> bytes:
        """Return the file with its last line ended, once it is no longer written."""
        content = await self._file.read_content()
        return content if content.endswith(b"\n") or not content else content + b"\n"

    async def _ask_first_row(self, count: int) -> int:
        """Ask which row is next: a run that was resumed does not begin with the first one."""
        if self._operator is None:
            raise self._file.file_error("which row is next is unknown", "Give first_row in cell.toml.")
        name = self._file.options.path.name
        text = make_message(
            "{name} has {count} rows. Which one belongs to the next pose? (1 unless the run was resumed)",
            name=name,
            count=count,
        )
        answer = await self._operator.ask_question(Question(f"first_row:{self._file.device}", text))
        try:
            return int(answer.value)
        except ValueError:
            raise self._file.file_error(
                make_message("{typed!r} is no row", typed=answer.value), "Resume, and give a whole number."
            ) from None


def _read_file(path: Path) -> bytes:
    """Read a plain file; blocking, for the worker."""
    try:
        found = path.stat()
    except FileNotFoundError:
        if path.parent.is_dir():
            return b""
        raise
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("it is not a plain file")
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(make_message("it is larger than {most} MB", most=MOST_BYTES // 1_000_000))
    if content.startswith(_UTF_16) or b"\0" in content[:4096]:
        raise ValueError("it is not a text file in UTF-8")
    return content


def _decode_text(content: bytes) -> str:
    """Return the text; words that are not UTF-8 may stand in it, numbers are ASCII."""
    return content.decode("utf-8-sig", errors="replace")


def _last_line(content: bytes) -> bytes:
    return content[content.rfind(b"\n") + 1 :]


def _first_change(before: bytes, now: bytes) -> str:
    lines = list(zip(before.splitlines(), now.splitlines(), strict=False))
    changed = next((i for i, (old, new) in enumerate(lines, start=1) if old != new), None)
    if changed is None:
        return make_message(
            "it has become shorter, from {before} to {now} bytes", before=len(before), now=len(now)
        )
    return make_message("line {line} has changed since it was read", line=changed)
