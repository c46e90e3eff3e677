"""A disk that keeps only what was synced: after a power cut, writes since the last sync survive at random.

*Imitates*: a file system on a drive with a volatile write cache, as seen through SQLite's VFS.
*Modelled*: writes and truncations since the last sync of a file are lost, kept or torn at 512-byte sectors,
each on its own; the cut may fall before any operation.
*Not modelled*: damage to sectors that were not being written; loss of a synced file's directory entry.
"""

# ruff: noqa: N802  SQLite names these methods
import random
from dataclasses import dataclass, field

import apsw

SECTOR = 512


class PowerCutError(Exception):
    """The lights went out."""


@dataclass
class SimulatedFile:
    """One file: what would survive, and what was done to it since."""

    durable: bytearray = field(default_factory=bytearray)
    visible_bytes: bytearray = field(default_factory=bytearray)
    pending: list[tuple[int, bytes | None]] = field(default_factory=list)  # (offset, data); None truncates

    def write(self, offset: int, data: bytes) -> None:
        self.pending.append((offset, data))
        _apply_write(self.visible_bytes, offset, data)

    def truncate(self, size: int) -> None:
        self.pending.append((size, None))
        del self.visible_bytes[size:]

    def sync(self) -> None:
        self.durable = bytearray(self.visible_bytes)
        self.pending.clear()

    def after_the_cut(self, rng: random.Random) -> "SimulatedFile":
        survivor = bytearray(self.durable)
        for offset, data in self.pending:
            fate = rng.random()
            if fate < 0.4:
                continue
            if data is None:
                del survivor[offset:]
            elif fate < 0.7:
                _apply_write(survivor, offset, data)
            else:
                _apply_torn(survivor, offset, data, rng)
        return SimulatedFile(bytearray(survivor), survivor)


@dataclass
class SimulatedDisk:
    """All files of one machine. The power fails at operation ``cut_at``."""

    files: dict[str, SimulatedFile] = field(default_factory=dict)
    cut_at: int | None = None
    operations: int = 0

    def count_operation(self) -> None:
        """Do one operation, or none: the power is gone."""
        if self.cut_at is not None and self.operations >= self.cut_at:
            raise PowerCutError
        self.operations += 1

    def after_the_cut(self, rng: random.Random) -> "SimulatedDisk":
        """Return the disk as it is found when the power is back."""
        return SimulatedDisk({name: platter.after_the_cut(rng) for name, platter in self.files.items()})


class OpenFile:
    """A file handle for SQLite."""

    def __init__(self, disk: SimulatedDisk, name: str) -> None:
        self._disk, self._platter = disk, disk.files.setdefault(name, SimulatedFile())

    def xRead(self, amount: int, offset: int) -> bytes:
        return bytes(self._platter.visible_bytes[offset : offset + amount])

    def xWrite(self, data: bytes, offset: int) -> None:
        self._disk.count_operation()
        self._platter.write(offset, bytes(data))

    def xTruncate(self, size: int) -> None:
        self._disk.count_operation()
        self._platter.truncate(size)

    def xSync(self, flags: int) -> None:
        self._disk.count_operation()
        self._platter.sync()

    def xFileSize(self) -> int:
        return len(self._platter.visible_bytes)

    def xSectorSize(self) -> int:
        return SECTOR

    def xDeviceCharacteristics(self) -> int:
        return 0  # promises nothing: no atomic, no sequential, no safe append

    def xFileControl(self, operation: int, pointer: int) -> bool:
        return False

    def xLock(self, level: int) -> None: ...
    def xUnlock(self, level: int) -> None: ...
    def xCheckReservedLock(self) -> bool:
        return False

    def xClose(self) -> None: ...


class DiskVfs(apsw.VFS):
    """Registers a disk with SQLite under its own name."""

    def __init__(self, name: str, disk: SimulatedDisk) -> None:
        self._disk = disk
        super().__init__(name, base="")

    def xOpen(self, name, flags):
        path = name.filename() if isinstance(name, apsw.URIFilename) else name
        return OpenFile(self._disk, path or f"temporary-{self._disk.operations}")

    def xAccess(self, path: str, flags: int) -> bool:
        return path in self._disk.files

    def xDelete(self, path: str, sync: bool) -> None:
        self._disk.count_operation()
        self._disk.files.pop(path, None)

    def xFullPathname(self, path: str) -> str:
        return path


def _apply_write(content: bytearray, offset: int, data: bytes) -> None:
    if len(content) < offset:
        content.extend(bytes(offset - len(content)))
    content[offset : offset + len(data)] = data


def _apply_torn(content: bytearray, offset: int, data: bytes, rng: random.Random) -> None:
    for start in range(0, len(data), SECTOR):
        if rng.random() < 0.5:
            _apply_write(content, offset + start, data[start : start + SECTOR])
