"""A certificate as PDF/A-2b, set by typst from the same blocks as the HTML page: fonts inside, no date of today.

The fonts are those that typst carries, so that the same certificate is the same file on every computer. Names in
other scripts take a font of this computer; where none has the characters, nothing is written.
"""

from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Literal

import orjson
import typst

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.certificates.blocks import CertificatePage
from cellcal.service.times import read_time

_TEMPLATE = Path(__file__).with_name("certificate.typ")
_LETTERS = "Libertinus Serif"
_STANDARD: Literal["a-2b"] = "a-2b"
_MORE_SCRIPTS = (
    "Noto Serif CJK SC",
    "Noto Sans CJK SC",
    "Source Han Serif SC",
    "Source Han Sans SC",
    "WenQuanYi Micro Hei",
    "WenQuanYi Zen Hei",
    "Noto Serif",
    "Noto Sans",
    "DejaVu Serif",
    "DejaVu Sans",
)


class PdfError(CellError):
    """A certificate cannot be set as PDF."""

    code = "certificate.pdf"


class MissingGlyphError(PdfError):
    """The text holds characters that no font of this computer has."""


def as_pdf(page: CertificatePage) -> bytes:
    """Return the PDF; the same page gives the same bytes.

    Raises
    ------
    LettersError
        The text holds characters that no font of this computer has.
    """
    try:
        return _compile_pdf(page, of_computer=False)
    except typst.TypstError as error:
        if not _lacks_letters(error):
            raise _compile_error(error) from error
    try:
        return _compile_pdf(page, of_computer=True)
    except typst.TypstError as error:
        raise (_unknown_letters(error) if _lacks_letters(error) else _compile_error(error)) from error


def _compile_pdf(page: CertificatePage, *, of_computer: bool) -> bytes:
    ended = read_time(page.ended_utc)
    compiler = _make_compiler(page, of_computer=of_computer)
    found = compiler.compile(format="pdf", pdf_standards=_STANDARD, timestamp=int(ended.timestamp()))
    assert isinstance(found, bytes)
    return found


def _make_compiler(page: CertificatePage, *, of_computer: bool) -> typst.Compiler:
    fonts = _load_fonts(of_computer=of_computer)
    families = set(fonts.families())
    letters = [_LETTERS, *(family for family in _MORE_SCRIPTS if family in families)]
    inputs = {"page": orjson.dumps(_as_data(page)).decode(), "fonts": orjson.dumps(letters).decode()}
    return typst.Compiler(_TEMPLATE.read_bytes(), font_paths=fonts, sys_inputs=inputs)


@cache
def _load_fonts(*, of_computer: bool) -> typst.Fonts:
    return typst.Fonts(include_system_fonts=of_computer, include_embedded_fonts=True)


def _as_data(page: CertificatePage) -> dict[str, object]:
    day = read_time(page.ended_utc)
    return asdict(page) | {"day": [day.year, day.month, day.day]}


def _lacks_letters(error: typst.TypstError) -> bool:
    return "could not be displayed" in error.diagnostic


def _unknown_letters(error: typst.TypstError) -> MissingGlyphError:
    return MissingGlyphError(
        make_message(
            "the certificate holds characters that no font of this computer has: {characters}.",
            characters=error.message,
        ),
        remedy="Install one that has them (Debian: `apt install fonts-noto-cjk`, or fonts-noto for other scripts), "
        "then ask for the PDF again. The JSON, text and HTML are complete without.",
    )


def _compile_error(error: typst.TypstError) -> PdfError:
    return PdfError(
        make_message("the PDF could not be set: {message}.", message=error.message),
        remedy="Report this with the JSON file.",
    )
