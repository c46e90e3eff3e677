"""Text of a controller's variables (.VA), read without losing a byte: every value knows where it stands.

A file is a row of variables. Each begins with a heading at the left margin,
``[*SYSTEM*]$DMR_GRP  Storage: SHADOW  Access: RW  : ARRAY[1] OF DMR_GRP_T``, and what follows belongs to it: fields
with a value, fields that are arrays, elements one per line, positions over several lines. Only the variables that
are asked for are looked into; a line that is not understood is refused there and kept everywhere else.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import prod

from cellcal.calibration.message import make_message
from cellcal.drivers.fanuc.program_files.va_positions import PositionLines, VaPosition
from cellcal.drivers.fanuc.program_files.va_spots import ValueSpot, damaged_file_error
from cellcal.drivers.programs.errors import ProgramFileError

ENCODING = "cp437"  # one byte is one character, whatever the byte
MAX_FILE_BYTES = 64 * 2**20
MAX_LINE_BYTES = 4096
_HEADING = re.compile(
    r"\[([^\]]*)\](\S+)[ \t]+Storage:[ \t]*(\S+)[ \t]+Access:[ \t]*(\S+)[ \t]*:[ \t]*(\S.*?)[ \t]*\Z"
)
_BEGINS_HEADING = re.compile(r"^\[[^\d\s\]][^\n]*", re.MULTILINE)
_ARRAY = re.compile(r"ARRAY\[(\d+(?:,\d+)*)\] OF (\S.*)\Z")
_FIELD = re.compile(r"[ \t]*Field:[ \t]*(\S+)[ \t]+(\S.*)\Z")
_SCALAR = re.compile(r"Access:[ \t]*\w+[ \t]*:[ \t]*([^=]*?)[ \t]*=[ \t]?(.*)\Z")
_ELEMENT = re.compile(r"[ \t]*\[(\d+(?:,\d+)*)\][ \t]*=[ \t]*(.*?)[ \t]*\Z")
_POSITIONS = ("POSITION", "Position Reg", "XYZWPREXT", "JOINTPOS")
_PLAIN_KINDS = ("INTEGER", "REAL", "BOOLEAN", "SHORT", "BYTE", "STRING", *_POSITIONS)
_UNTOUCHED = re.compile(
    r"[ \t]*(?:<[^>]*>[ \t]*)*\Z"
)  # blank, or what the controller's web server wraps around


@dataclass(frozen=True, slots=True)
class VaVariable:
    """One variable: its values and positions by their full path, as the file spells it."""

    file: str
    name: str
    line: int
    values: Mapping[str, ValueSpot]
    positions: Mapping[str, VaPosition]

    def find_value(self, path: str) -> ValueSpot:
        """Return the value at a path such as ``$DMR_GRP[1].$MASTER_COUN[3]``.

        Raises
        ------
        ProgramFileError
            The file does not hold it.
        """
        found = self.values.get(path)
        if found is None:
            raise ProgramFileError(
                self.file,
                make_message("{path} is not there.", path=path),
                line=self.line,
                remedy="Save all variables of the controller again.",
            )
        return found


@dataclass(frozen=True, slots=True)
class _OpenArray:
    path: str
    shape: tuple[int, ...]
    kind: str
    line: int


@dataclass(frozen=True)
class VaFile:
    """A .VA file: its bytes, and its variables when asked for."""

    name: str
    data: bytes = field(repr=False)

    @classmethod
    def from_bytes(cls, name: str, data: bytes) -> "VaFile":
        """Take the bytes of a file.

        Raises
        ------
        ProgramFileError
            It is too large, no text of variables, or damaged where that shows without looking into a variable.
        """
        if len(data) > MAX_FILE_BYTES:
            raise ProgramFileError(
                name,
                make_message(
                    "{data_count:.0f} MB is more than a controller writes ({max_file_bytes} MB).",
                    data_count=len(data) / 2**20,
                    max_file_bytes=MAX_FILE_BYTES >> 20,
                ),
                remedy="Give the folder of the backup itself.",
            )
        file = cls(name, data)
        file._refuse_damage()
        return file

    @property
    def variable_names(self) -> tuple[str, ...]:
        """Return the names of the variables, in the order of the file."""
        return tuple(name for name, _, _ in self._variable_headings)

    def has_variable(self, variable: str) -> bool:
        """Return whether the file holds a variable."""
        return variable in self.variable_names

    def read_variable(self, name: str) -> VaVariable:
        """Read one variable.

        Raises
        ------
        ProgramFileError
            It is missing, stands there twice, or holds a line that is not understood.
        """
        places = [i for i, (heading_name, _, _) in enumerate(self._variable_headings) if heading_name == name]
        if not places:
            raise ProgramFileError(
                self.name,
                make_message("{name} is not in this file.", name=name),
                remedy="Save it again, whole.",
            )
        if len(places) > 1:
            line = self._line_of(self._variable_headings[places[1]][1])
            raise damaged_file_error(
                self.name, line, make_message("{path} is there a second time.", path=name)
            )
        _, start, kind = self._variable_headings[places[0]]
        end = (
            self._variable_headings[places[0] + 1][1]
            if places[0] + 1 < len(self._variable_headings)
            else len(self._decoded_text)
        )
        return _VariableReader(self.name, name, kind, self._line_of(start)).read_lines(
            self._iterate_lines(start, end)
        )

    def replace_values(self, changes: Mapping[ValueSpot, str]) -> bytes:
        """Return the file with other text at some places; all else keeps every byte."""
        pieces, at = [], 0
        for spot, text in sorted(changes.items(), key=lambda change: change[0].start):
            pieces += [self.data[at : spot.start], text.encode(ENCODING)]
            at = spot.start + len(spot.text)
        return b"".join([*pieces, self.data[at:]])

    @cached_property
    def _decoded_text(self) -> str:
        return self.data.decode(ENCODING)

    @cached_property
    def _variable_headings(self) -> tuple[tuple[str, int, str], ...]:
        """Return name, offset and type of every variable."""
        found = []
        for heading in _BEGINS_HEADING.finditer(self._decoded_text):
            parts = _HEADING.match(heading[0].rstrip("\r"))
            if parts is None:
                raise damaged_file_error(
                    self.name, self._line_of(heading.start()), "this heading of a variable is not whole."
                )
            found.append((parts[2], heading.start(), parts[5]))
        return tuple(found)

    def _line_of(self, offset: int) -> int:
        return self._decoded_text.count("\n", 0, offset) + 1

    def _iterate_lines(self, start: int, end: int) -> Iterator[tuple[int, str]]:
        """Yield the offset and text of each line after the heading."""
        at = self._decoded_text.find("\n", start, end) + 1
        while 0 < at < end:
            stop = self._decoded_text.find("\n", at, end)
            stop = end if stop < 0 else stop
            yield at, self._decoded_text[at:stop].rstrip("\r")
            at = stop + 1

    def _refuse_damage(self) -> None:
        control_character = re.search(r"[\x00-\x08\x0e-\x1f]", self._decoded_text)
        if control_character is not None:
            raise damaged_file_error(
                self.name,
                self._line_of(control_character.start()),
                make_message("byte {ord:#04x} is no text.", ord=ord(control_character[0])),
            )
        for number, line in enumerate(self._decoded_text.split("\n"), 1):
            if len(line) > MAX_LINE_BYTES:
                raise damaged_file_error(
                    self.name,
                    number,
                    make_message("the line has {line_count} characters.", line_count=len(line)),
                )
        if not self._variable_headings:
            raise ProgramFileError(
                self.name,
                "there is no variable in it, as in a controller's .VA file.",
                remedy="Save the variables as ASCII (.VA): FILE, BACKUP, All of above, or read MD: by FTP.",
            )
        for number, line in enumerate(self._decoded_text[: self._variable_headings[0][1]].split("\n"), 1):
            if not _UNTOUCHED.match(line.rstrip("\r")):
                raise damaged_file_error(self.name, number, "the beginning of the first variable is missing.")


class _VariableReader:
    """Reads the lines of one variable."""

    def __init__(self, file: str, name: str, kind: str, line: int) -> None:
        self.file, self.name, self.line = file, name, line
        self.values: dict[str, ValueSpot] = {}
        self.positions: dict[str, VaPosition] = {}
        self.open: tuple[str, PositionLines] | None = None
        self.arrays: list[_OpenArray] = []
        self.array: _OpenArray | None = None
        whole, _, value = kind.partition("=")
        self._declare_array(name, whole.strip(), line)
        if self.array is None and value.strip():
            self.values[name] = ValueSpot(value.strip(), -1, line)
        elif self.array is None and whole.strip() in _POSITIONS:
            self.open = name, PositionLines(file, line)

    def read_lines(self, lines: Iterator[tuple[int, str]]) -> VaVariable:
        number = self.line
        for number, (offset, text) in enumerate(lines, self.line + 1):
            if not _UNTOUCHED.match(text):
                self._take_line(offset, text, number)
        self._close_position()
        self._refuse_gaps(number)
        return VaVariable(self.file, self.name, self.line, self.values, self.positions)

    def _take_line(self, offset: int, text: str, line: int) -> None:
        field_line, element = _FIELD.match(text), _ELEMENT.match(text)
        if field_line is not None:
            self._close_position()
            self._take_field(field_line, offset, line)
        elif element is not None and self.array is not None:
            self._close_position()
            self._take_element(element, offset, line)
        elif self.open is None or not self.open[1].take_line(offset, text, line):
            raise damaged_file_error(
                self.file,
                line,
                make_message(
                    "this line of {name} is not understood: {text!r}.", name=self.name, text=text.strip()[:60]
                ),
            )

    def _take_field(self, found: re.Match[str], offset: int, line: int) -> None:
        path, rest = found[1], found[2]
        if not path.startswith((f"{self.name}.", f"{self.name}[")):
            raise damaged_file_error(
                self.file,
                line,
                make_message("{path} stands among the fields of {name}.", path=path[:60], name=self.name),
            )
        scalar = _SCALAR.match(rest)
        self.array = None
        if scalar is None:
            self._declare_array(path, rest.strip(), line)
            if self.array is None:
                raise damaged_file_error(
                    self.file, line, make_message("the field {path} is not understood.", path=path[:60])
                )
        elif scalar[1] in _POSITIONS and not scalar[2].strip():
            self.open = path, PositionLines(self.file, line)
        else:
            value = scalar[2].rstrip()
            self._store_value(path, ValueSpot(value, offset + found.start(2) + scalar.start(2), line))

    def _declare_array(self, path: str, kind: str, line: int) -> None:
        found = _ARRAY.match(kind)
        if found is None and kind.startswith("ARRAY"):
            raise damaged_file_error(
                self.file,
                line,
                make_message(
                    "the heading of {path} is not understood: {kind!r}.", path=path[:60], kind=kind[:60]
                ),
            )
        if found is None:
            return
        self.array = _OpenArray(path, tuple(int(n) for n in found[1].split(",")), found[2].strip(), line)
        self.arrays.append(self.array)

    def _take_element(self, found: re.Match[str], offset: int, line: int) -> None:
        array = self.array
        assert array is not None
        index = tuple(int(n) for n in found[1].split(","))
        fits = len(index) == len(array.shape)
        if not fits or any(not 1 <= i <= n for i, n in zip(index, array.shape, strict=True)):
            raise damaged_file_error(
                self.file,
                line,
                make_message("element [{found}] is outside of {path}.", found=found[1], path=array.path),
            )
        path = f"{array.path}[{','.join(map(str, index))}]"
        if array.kind in _POSITIONS:
            self.open = path, PositionLines(self.file, line)
            if found[2] and not self.open[1].take_head(found[2]):
                raise damaged_file_error(
                    self.file,
                    line,
                    make_message("{path} is not understood: {found!r}.", path=path, found=found[2][:60]),
                )
        else:
            self._store_value(path, ValueSpot(found[2], offset + found.start(2), line))

    def _store_value(self, path: str, spot: ValueSpot) -> None:
        if path in self.values or path in self.positions:
            raise damaged_file_error(
                self.file, spot.line, make_message("{path} is there a second time.", path=path)
            )
        self.values[path] = spot

    def _close_position(self) -> None:
        if self.open is None:
            return
        path, lines = self.open
        if path in self.positions or path in self.values:
            raise damaged_file_error(
                self.file, lines.line, make_message("{path} is there a second time.", path=path)
            )
        self.positions[path] = lines.to_position(path)
        self.open = None

    def _refuse_gaps(self, last: int) -> None:
        counts: dict[str, int] = {}
        for path in (*self.values, *self.positions):
            if path.endswith("]"):
                counts[path.rpartition("[")[0]] = counts.get(path.rpartition("[")[0], 0) + 1
        for array in self.arrays:
            whole, got = prod(array.shape), counts.get(array.path, 0)
            # a structure has its fields listed in place of elements; its type's name may be cut off anywhere
            if got not in (0, whole) or (got == 0 and array.kind.startswith(_PLAIN_KINDS)):
                raise damaged_file_error(
                    self.file,
                    min(array.line + got, last),
                    make_message(
                        "{path} has {got} of {whole} elements.", path=array.path, got=got, whole=whole
                    ),
                )
