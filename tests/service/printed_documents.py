"""What printed certificates say, read back from their bytes: a small reader of PDF and one of HTML.

It knows PDF as typst writes it (objects in the open, strings of two-byte glyphs with /ToUnicode) and no more.
"""

import json
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path

from cellcal.service.certificates.blocks import (
    Block,
    BulletBlock,
    CertificatePage,
    FactBlock,
    ParagraphBlock,
    PictureBlock,
    SignatureFields,
    TableBlock,
    TableCell,
)
from cellcal.service.certificates.languages import build_translations
from cellcal.service.certificates.page_sections import page_of
from cellcal.service.certificates.printing import html_from, page_from, pdf_from
from cellcal.service.record.signing import check_document
from cellcal.service.translation import LOCALES, Locale, Translations
from tests.service.source_sentences import ROOT, SENTENCE

FIGURE = re.compile(r"(?<![\w.])([-+]?\d+(?:[.,]\d+)?(?:e[-+]\d+)?)\s{0,2}(mm|deg\b|turns|%|°C|hPa)")
_ESCAPES = {"n": "\n", "r": "\r", "t": "\t", "b": "\b", "f": "\f"}


def verify_paper(json_path: Path) -> None:
    """See that page, PDF and text of a certificate say the same as its signed content, figure by figure."""
    page = page_from(json_path)
    html, pdf = HtmlText.read_html(html_from(json_path)), PdfReader(pdf_from(json_path))
    said_html, said_pdf = squeeze_text(html.text), squeeze_text(pdf.read_text())
    for words in words_of(page):
        assert squeeze_text(words) in said_html, words
        assert squeeze_text(words) in said_pdf, words
    figures = sorted(FIGURE.findall(html.text))
    assert figures == sorted(FIGURE.findall(pdf.read_text()))
    in_text = set(FIGURE.findall(" ".join(json_path.with_suffix(".txt").read_text().split())))
    assert in_text <= set(figures), in_text - set(figures)
    assert pdf.is_archival()
    assert pdf.list_fonts()
    assert all(pdf.list_fonts().values()), "a font is not in the file"
    assert page.run_id in said_pdf
    assert page.sha256 in said_pdf
    assert not html.asks_for
    verify_spoken(json_path)


def verify_spoken(json_path: Path) -> None:
    """See that every sentence of a certificate has its words in every language, and the same figures."""
    checked = check_document(json_path.read_bytes())
    assert checked.content is not None
    signed = figures_of(page_from(json_path))
    for locale in LOCALES[1:]:
        words = RecordingTranslations.read_from_source(locale)
        page = page_of(checked.content, checked.sha256, checked.public_key, words)
        assert page.locale == locale
        assert not words.unsaid - ALIKE, (locale, words.unsaid)
        assert figures_of(page) == signed, locale


def figures_of(page: CertificatePage) -> list[tuple[str, str]]:
    """Return every figure with its unit; whole turns, whose unit is a word, without."""
    sentences = FIGURE.findall(" ".join(words_of(page)))
    return sorted((number.replace(",", "."), unit) for number, unit in sentences if unit != "turns")


ALIKE = {"", "u", "U (k = 2)"}  # in every language
OWN_TABLES = "service/certificates/translations"


class RecordingTranslations(Translations):
    """A language's words that remember which sentences they lack."""

    unsaid: set[str]

    @classmethod
    def read_from_source(cls, locale: Locale) -> "RecordingTranslations":
        """Read tables where they are written, not where the pages' build copies them."""
        made = build_translations(locale, source_table(locale))
        translations = cls(locale, made.table, made.commas, made.find)
        object.__setattr__(translations, "unsaid", set())
        return translations

    def translate(self, text: str) -> str:
        self.unsaid.update(part for part in SENTENCE.split(text) if not self.is_translated(part))
        return super().translate(text)

    def translate_step(self, step_name: str) -> str:
        translated_step = super().translate_step(step_name)
        if translated_step == step_name:
            self.unsaid.add(step_name)
        return translated_step


def source_table(locale: Locale) -> dict[str, str]:
    """Return every sentence of a language: of procedures, refusals and certificates."""
    kinds = (*(f"web/src/locales/{kind}" for kind in ("procedures", "settings", "refusals")), OWN_TABLES)
    table: dict[str, str] = {}
    for kind in kinds:
        table |= json.loads((ROOT / kind / f"{locale}.json").read_text(encoding="utf-8"))
    return table


def words_of(page: CertificatePage) -> list[str]:
    """Return every text of a page but those inside drawings."""
    found = [page.heading, page.title, page.status, page.verdict, page.rule]
    for section in page.sections:
        found.append(section.title)
        for block in section.blocks:
            found += _words_of_block(block)
    return found


def _words_of_block(block: Block) -> list[str]:
    match block:
        case ParagraphBlock():
            return [block.text]
        case BulletBlock():
            return list(block.lines)
        case FactBlock():
            return [text for row in block.rows for text in row]
        case TableBlock():
            cells: list[TableCell] = [*block.head, *(cell for row in block.rows for cell in row)]
            return [block.caption, *(text for cell in cells for text in (cell.text, cell.below))]
        case PictureBlock():
            return [block.caption]
        case SignatureFields():
            return [block.statement]


def squeeze_text(text: str) -> str:
    """Return a text without blanks and line ends, as neither page keeps them."""
    return "".join(text.split())


class PdfReader:
    """The objects of a PDF."""

    def __init__(self, raw: bytes) -> None:
        found = re.findall(rb"(?:^|\n)(\d+) 0 obj\s(.*?)\sendobj", raw, re.DOTALL)
        self.objects = {int(number): body for number, body in found}

    def read_text(self) -> str:
        """Return the text of all sheets, in the order in which it is set."""
        sheets = [body for body in self.objects.values() if re.search(rb"/Type\s*/Page\b", body)]
        return "\n".join(map(self._sheet_text, sheets))

    def list_fonts(self) -> dict[str, bool]:
        """Return every font by name, and whether its letters are in the file."""
        bases = [body for body in self.objects.values() if b"/Type/Font/" in body and b"/Type0" not in body]
        return {
            re.search(rb"/BaseFont\s*/(\S+?)[/>\s]", body)[1].decode(): self._holds_letters(body)  # type: ignore[index]
            for body in bases
        }

    def is_archival(self) -> bool:
        """Return whether it says that it is PDF/A-2b."""
        metadata = next(body for body in self.objects.values() if b"pdfaid:part" in body)
        return b"<pdfaid:part>2<" in metadata and b"<pdfaid:conformance>B<" in metadata

    def _holds_letters(self, font: bytes) -> bool:
        descriptor = re.search(rb"/FontDescriptor\s+(\d+) 0 R", font)
        file = descriptor and re.search(rb"/FontFile[23]?\s+(\d+) 0 R", self.objects[int(descriptor[1])])
        return bool(file) and len(self._read_stream(int(file[1]))) > 200  # type: ignore[index]

    def _sheet_text(self, sheet: bytes) -> str:
        named = re.search(rb"/Font\s*<<(.*?)>>", self._sheet_resources(sheet), re.DOTALL)
        fonts = re.findall(rb"/(\w+)\s+(\d+) 0 R", named[1]) if named else []
        letters = {name.decode(): self._font_letters(int(number)) for name, number in fonts}
        content = re.search(rb"/Contents\s+(\d+) 0 R", sheet)
        assert content
        return _shown_text(self._read_stream(int(content[1])).decode("latin-1"), letters)

    def _sheet_resources(self, sheet: bytes) -> bytes:
        elsewhere = re.search(rb"/Resources\s+(\d+) 0 R", sheet)
        return self.objects[int(elsewhere[1])] if elsewhere else sheet

    def _font_letters(self, font: int) -> dict[int, str]:
        table = re.search(rb"/ToUnicode\s+(\d+) 0 R", self.objects[font])
        assert table
        pairs = re.findall(rb"<([0-9A-F]{4})> <([0-9A-F]+)>\n", self._read_stream(int(table[1])))
        return {
            int(code, 16): bytes.fromhex(hex_text.decode()).decode("utf-16-be") for code, hex_text in pairs
        }

    def _read_stream(self, number: int) -> bytes:
        head, _, rest = self.objects[number].partition(b"stream")
        length = re.search(rb"/Length (\d+)", head)
        assert length
        raw = rest.lstrip(b"\r\n")[: int(length[1])] if rest[:1] != b"\n" else rest[1 : 1 + int(length[1])]
        return zlib.decompress(raw) if b"FlateDecode" in head else raw


def _shown_text(content: str, letters: dict[str, dict[int, str]]) -> str:
    text, font, codes = [], "", b""
    for token in _content_tokens(content):
        if isinstance(token, bytes):
            codes += token
        elif token.startswith("/"):
            font = token[1:] if token[1:] in letters else font
        elif token == "BT":
            codes = b""  # what stood before belongs to tags
        elif token in ("TJ", "Tj"):
            text.append(
                "".join(letters[font][(codes[k] << 8) | codes[k + 1]] for k in range(0, len(codes), 2))
            )
            codes = b""
    return "\n".join(text)


def _content_tokens(content: str) -> Iterator[str | bytes]:
    """Return names and operators as text, strings as bytes; parentheses in a string may stand in pairs."""
    place = 0
    while place < len(content):
        if content[place] != "(":
            word = re.compile(r"/?\w+|/|[^(/\w]+", re.DOTALL).match(content, place)
            assert word
            yield word[0]
            place = word.end()
            continue
        begin = place = place + 1
        depth = 1
        while depth:
            if content[place] == "\\":
                place += 1  # what is escaped opens and closes nothing
            else:
                depth += {"(": 1, ")": -1}.get(content[place], 0)
            place += 1
        yield _unescape_string(content[begin : place - 1])


def _unescape_string(text: str) -> bytes:
    def _replace_escape(found: re.Match[str]) -> str:
        escape = found[1]
        return chr(int(escape, 8)) if escape[0].isdigit() else _ESCAPES.get(escape, escape)

    return re.sub(r"\\([0-7]{1,3}|.)", _replace_escape, text, flags=re.DOTALL).encode("latin-1")


@dataclass
class HtmlText(HTMLParser):
    """The words of a page outside its drawings, and whatever in it would fetch or run something."""

    text: str = ""
    asks_for: list[str] = field(default_factory=list)
    _aside: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    @classmethod
    def read_html(cls, html: str) -> "HtmlText":
        """Read a page."""
        found = cls()
        found.feed(html)
        return found

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("svg", "style", "title"):
            self._aside.append(tag)
        if tag in ("script", "link", "img", "iframe", "object", "embed", "form", "base", "image", "use"):
            self.asks_for.append(tag)
        for name, value in attrs:
            fetches = name in ("src", "href", "xlink:href", "style", "srcset", "action") or name.startswith(
                "on"
            )
            if fetches or "url(" in (value or ""):
                self.asks_for.append(f"{tag} {name}={value}")

    def handle_endtag(self, tag: str) -> None:
        if self._aside and self._aside[-1] == tag:
            self._aside.pop()

    def handle_data(self, data: str) -> None:
        if not self._aside:
            self.text += f"\n{data}"
