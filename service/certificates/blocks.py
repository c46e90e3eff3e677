"""What a printed certificate consists of, independent of its layout: page and PDF draw the same blocks.

Every figure in a block is text already, so that no two pages can round it differently.
"""

from dataclasses import dataclass
from typing import Literal

from cellcal.service.translation import Locale, Translations

Tone = Literal["plain", "quiet", "strong"]


@dataclass(frozen=True, slots=True)
class TableCell:
    """One cell of a table: what it says, and in a smaller line below it, why."""

    text: str
    below: str = ""
    number: bool = False  # at the right, digits below digits
    word: str = ""  # pass | fail | undecided | refused: drawn as such


def table_head(translations: Translations, *names: str) -> tuple[TableCell, ...]:
    """Return a table's head; "#" behind a name means a column of numbers."""
    return tuple(
        TableCell(translations.translate(name.removesuffix("#")), number=name.endswith("#")) for name in names
    )


@dataclass(frozen=True, slots=True)
class ParagraphBlock:
    """A paragraph."""

    text: str
    tone: Tone = "plain"
    kind: Literal["paragraph"] = "paragraph"


@dataclass(frozen=True, slots=True)
class BulletBlock:
    """A list."""

    lines: tuple[str, ...]
    kind: Literal["bullets"] = "bullets"


@dataclass(frozen=True, slots=True)
class FactBlock:
    """Names and what they are."""

    rows: tuple[tuple[str, str], ...]
    kind: Literal["facts"] = "facts"


@dataclass(frozen=True, slots=True)
class TableBlock:
    """A table; ``shares`` are the widths of its columns, in parts of the whole."""

    head: tuple[TableCell, ...]
    rows: tuple[tuple[TableCell, ...], ...]
    shares: tuple[int, ...]
    caption: str
    kind: Literal["table"] = "table"


@dataclass(frozen=True, slots=True)
class PictureBlock:
    """A drawing: SVG with its words, and its text alternative for screen readers."""

    svg: str
    alt: str
    caption: str
    kind: Literal["picture"] = "picture"


@dataclass(frozen=True, slots=True)
class SignatureFields:
    """Lines for a person's name, date and signature, below what the person signs for."""

    statement: str
    places: tuple[str, str, str]  # what to write on each line
    kind: Literal["fields"] = "fields"


Block = ParagraphBlock | BulletBlock | FactBlock | TableBlock | PictureBlock | SignatureFields


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands below it."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class CertificatePage:
    """A whole certificate or refusal record."""

    locale: Locale
    heading: str  # Calibration report, or Refusal record
    title: str
    status: str
    short_status: str  # at the foot of every sheet
    word: str  # pass | fail | undecided | refused
    verdict: str  # as people read it
    rule: str
    run_id: str
    sha256: str
    footer: tuple[str, str]  # of which run, and its hash
    ended_utc: str
    qr: PictureBlock
    sections: tuple[Section, ...]
