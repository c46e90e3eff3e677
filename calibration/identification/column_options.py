"""Columns as ``--columns`` takes them: how a cure writes them, so that it can be copied into a terminal."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

_BARE = re.compile(r"[\w.,=+-]*")  # needs no quotes in any shell
_UNTYPED = re.compile(r"""[,"`$\\!%\x00-\x1f]""")  # divides columns, or means something inside quotes, too


@dataclass(frozen=True, slots=True)
class TypedColumn:
    """A column, what its values are multiplied with, and what is added to a joint."""

    name: str
    sign: float = 1.0
    zero_deg: float = 0.0
    written: str = ""  # what to type for the column; its name if empty

    @property
    def is_modified(self) -> bool:
        """Whether it is not taken as it is written."""
        return self.sign < 0 or self.zero_deg != 0.0

    @property
    def typed_text(self) -> str:
        """As one types it."""
        zero = f"{self.zero_deg:+.6g}" if self.zero_deg else ""
        return f"{'-' if self.sign < 0 else ''}{self.written or self.name}{zero}"

    def turned(self) -> "TypedColumn":
        """Return the column with the other sign, of what it was with its zero."""
        return replace(self, sign=-self.sign, zero_deg=-self.zero_deg)

    def with_zero(self, more_deg: float) -> "TypedColumn":
        """Return the column with an angle added."""
        return replace(self, zero_deg=self.zero_deg + more_deg)


def columns_option(meaning: str, columns: Sequence[TypedColumn | str]) -> str:
    """Return the option that names columns so, in quotes where a shell would take it apart."""
    texts = [column if isinstance(column, str) else column.typed_text for column in columns]
    word = f"{meaning}={','.join(texts)}"
    return f"`--columns {_in_quotes(word)}`"


def _in_quotes(text: str) -> str:
    """Return a word of a command line: in double quotes, which every shell knows, where it needs some."""
    return text if _BARE.fullmatch(text) else f'"{text}"'


def is_bare(name: str) -> bool:
    """Return whether a column's name can be typed as it is."""
    return bool(_BARE.fullmatch(name)) and is_typable(name)


def is_typable(name: str) -> bool:
    """Return whether a column's name can be typed at all, be it in quotes."""
    return bool(name) and name == name.strip() and not _UNTYPED.search(name)
