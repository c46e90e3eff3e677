"""RTDE telegrams: cutting the stream, recipes, packing and unpacking. Knows no socket and no robot.

Imitates
    The framing of port 30004, protocol versions 1 and 2.
Source
    The maker's RTDE guide.
Modelled
    All package types; trailing commas in name lists (ur_rtde sends them, the maker's client does not).
Not modelled
    Property reads (type 82) of software 5.26 and later: answered as an unknown package.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import Any

from cellcal.fake_devices.universal_robots.rtde_fields import package_layout, value_count

_HEADER = Struct(">HB")
MAX_NAME_BYTES = 2048


class PackageType(IntEnum):
    """Package types, ASCII letters."""

    MESSAGE = ord("M")
    DATA = ord("U")
    VERSION = ord("v")
    PROTOCOL = ord("V")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class TelegramSplitter:
    """Cut a byte stream into telegrams: several in one read and halves are normal."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def split_telegrams(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield (type, payload) of every telegram that is complete."""
        self._buffer += data
        while len(self._buffer) >= 3:
            size, kind = _HEADER.unpack_from(self._buffer)
            if size < 3:
                raise ValueError(f"a telegram cannot be {size} bytes long")
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[3:size])
            del self._buffer[:size]
            yield kind, payload


def make_telegram(kind: int, payload: bytes = b"") -> bytes:
    """Return one telegram with its header."""
    return _HEADER.pack(3 + len(payload), kind) + payload


def make_message(text: str, source: str = "RTDE", level: int = 2, protocol: int = 2) -> bytes:
    """Return a text message telegram (level 0 exception, 1 error, 2 warning, 3 info)."""
    body, origin = text.encode()[:255], source.encode()[:255]
    if protocol == 1:
        return make_telegram(PackageType.MESSAGE, bytes([level]) + body)
    return make_telegram(
        PackageType.MESSAGE, bytes([len(body)]) + body + bytes([len(origin)]) + origin + bytes([level])
    )


def names_in(payload: bytes) -> list[str]:
    """Return the variable names of a setup request; the empty one after a trailing comma is none."""
    text = payload.decode("ascii", "replace")
    names = text.split(",")
    return names[:-1] if names[-1] == "" else names


Getter = Callable[[], Any]


@dataclass(frozen=True)
class OutputRecipe:
    """The values that one client wants to read, and how often."""

    kinds: tuple[str, ...]
    getters: tuple[Getter, ...]
    every: int  # controller steps
    recipe_id: int | None  # none in protocol 1

    def data_layout(self) -> Struct:
        """Return the layout of the data package."""
        return package_layout(list(self.kinds), with_recipe_id=self.recipe_id is not None)


class DataPacker:
    """Turns the present values of a recipe into a data telegram."""

    def __init__(self, recipe: OutputRecipe) -> None:
        self._layout = recipe.data_layout()
        self._start = [] if recipe.recipe_id is None else [recipe.recipe_id]
        self._fields = [
            (get, value_count(kind) > 1) for get, kind in zip(recipe.getters, recipe.kinds, strict=True)
        ]
        self._header = _HEADER.pack(3 + self._layout.size, PackageType.DATA)

    def data_telegram(self) -> bytes:
        """Return the package of this moment."""
        values: list[Any] = list(self._start)
        for get, many in self._fields:
            if many:
                values.extend(get())
            else:
                values.append(get())
        return self._header + self._layout.pack(*values)


@dataclass(frozen=True)
class InputRecipe:
    """The values that one client writes with one data package."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]

    def unpack_values(self, payload: bytes) -> dict[str, Any] | None:
        """Return the values of a data package without its recipe id, or None when its size is wrong."""
        layout = package_layout(list(self.kinds), with_recipe_id=False)
        if len(payload) != layout.size:
            return None
        flat, found = list(layout.unpack(payload)), {}
        for name, kind in zip(self.names, self.kinds, strict=True):
            count = value_count(kind)
            found[name] = tuple(flat[:count]) if count > 1 else flat[0]
            del flat[:count]
        return found
