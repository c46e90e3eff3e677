"""An object dictionary: numbers with types, access rights and consequences.

Imitates
    The object dictionary of a CiA 301 device.
Source
    CiA 301: data types, access rights, abort codes.
Modelled
    Integers of 8, 16 and 32 bits and strings; sub-indices; refusals with the right abort code.
Not modelled
    Domains, access by PDO to single sub-indices.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass

NO_OBJECT, NO_SUB_INDEX = 0x06020000, 0x06090011
READ_ONLY, WRITE_ONLY = 0x06010002, 0x06010001
BAD_LENGTH, OUT_OF_RANGE = 0x06070010, 0x06090030
BAD_COMMAND, BAD_TOGGLE, CANNOT_STORE = 0x05040001, 0x05030000, 0x08000020

_FORMATS = {"U8": "<B", "U16": "<H", "U32": "<I", "I8": "<b", "I16": "<h", "I32": "<i"}


class AbortError(Exception):
    """An SDO abort."""

    def __init__(self, code: int) -> None:
        super().__init__(f"abort 0x{code:08X}")
        self.code = code


@dataclass(frozen=True)
class SdoEntry:
    """One sub-index: its type, and how to read and write it."""

    kind: str
    get: Callable[[], int | str] | None
    put: Callable[[int], None] | None = None

    def read_bytes(self) -> bytes:
        """Return the value's bytes."""
        if self.get is None:
            raise AbortError(WRITE_ONLY)
        value = self.get()
        return value.encode("ascii") if isinstance(value, str) else struct.pack(_FORMATS[self.kind], value)

    def write_bytes(self, data: bytes) -> None:
        """Take a value's bytes."""
        if self.put is None:
            raise AbortError(READ_ONLY)
        layout = _FORMATS[self.kind]
        if len(data) != struct.calcsize(layout):
            raise AbortError(BAD_LENGTH)
        self.put(int(struct.unpack(layout, data)[0]))


class ObjectDictionary:
    """All entries by index and sub-index."""

    def __init__(self, entries: dict[tuple[int, int], SdoEntry]) -> None:
        self._entries = entries
        self._indices = {index for index, _ in entries}

    def find_entry(self, index: int, sub: int) -> SdoEntry:
        """Return one entry or refuse as CiA 301 says."""
        if index not in self._indices:
            raise AbortError(NO_OBJECT)
        if (index, sub) not in self._entries:
            raise AbortError(NO_SUB_INDEX)
        return self._entries[index, sub]


class ObjectSettings:
    """Numbers that a client may change within limits, that are saved on request and restored at power-on."""

    def __init__(self, defaults: dict[str, int]) -> None:
        self._defaults = dict(defaults)
        self._saved = dict(defaults)
        self.now = dict(defaults)

    def make_entry(self, name: str, kind: str, lowest: int, highest: int) -> SdoEntry:
        """Return the entry of one setting."""

        def set_value(value: int) -> None:
            if not lowest <= value <= highest:
                raise AbortError(OUT_OF_RANGE)
            self.now[name] = value

        return SdoEntry(kind, lambda: self.now[name], set_value)

    def save_settings(self) -> None:
        """Keep what is set."""
        self._saved = dict(self.now)

    def load_defaults(self) -> None:
        """Forget what was saved; the defaults count after the next power-on."""
        self._saved = dict(self._defaults)

    def power_on(self) -> None:
        """Return to what was saved."""
        self.now = dict(self._saved)
