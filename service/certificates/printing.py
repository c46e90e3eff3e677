"""Paper of a certificate: the page and the PDF, made from the signed file after it was checked."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.files import SHARED_FILE, replace_file
from cellcal.service.record.signing import check_document, read_document
from cellcal.service.translation import Locale

if TYPE_CHECKING:
    from cellcal.service.certificates.blocks import CertificatePage

_IN_ENGLISH = (
    "Set in English: this computer has no font for the language that was asked for "
    "(Debian: apt install fonts-noto-cjk)."
)
_log = logging.getLogger(__name__)


class PrintingError(CellError):
    """A certificate cannot be printed, or not be written where it was wanted."""

    code = "certificate"


@dataclass(frozen=True, slots=True)
class PrintedFiles:
    """The files beside a certificate; None for what could not be made, with the reason."""

    html_path: Path | None
    pdf_path: Path | None
    trouble: str = ""


def page_from(json_path: Path, locale: Locale = "en") -> "CertificatePage":
    """Return the page of a signed certificate on disk, in a language.

    Raises
    ------
    PrintingError
        The file cannot be read, or is not what was signed: nothing is printed from it.
    """
    from cellcal.service.certificates.languages import translations_in  # noqa: PLC0415  tables only where they are wanted
    from cellcal.service.certificates.page_sections import page_of  # noqa: PLC0415  as above, with drawings and codes

    raw = read_document(json_path)
    checked = check_document(raw) if isinstance(raw, bytes) else raw
    if checked.content is None:
        raise PrintingError(
            f"{json_path}: {checked.sentence} Nothing is printed from it.",
            remedy="Write the certificate again with `cellcal certificate`.",
        )
    return page_of(checked.content, checked.sha256, checked.public_key, translations_in(locale))


def html_from(json_path: Path, locale: Locale = "en") -> str:
    """Return a signed certificate as one HTML page."""
    from cellcal.service.certificates.html import as_html  # noqa: PLC0415

    return as_html(page_from(json_path, locale))


def pdf_from(json_path: Path, locale: Locale = "en") -> bytes:
    """Return a signed certificate as PDF/A; in English, and saying so, where no font has the language's letters.

    Raises
    ------
    PrintingError
        As ``page_from``.
    PdfError
        No font of this computer has some of its characters.
    """
    from cellcal.service.certificates.pdf import MissingGlyphError, as_pdf  # noqa: PLC0415  typst is a large library

    try:
        return as_pdf(page_from(json_path, locale))
    except MissingGlyphError:
        if locale == "en":
            raise
    english = page_from(json_path)
    return as_pdf(
        replace(
            english,
            status=make_message("{status} {in_english}", status=english.status, in_english=_IN_ENGLISH),
        )
    )


def print_beside(json_path: Path) -> PrintedFiles:
    """Write page and PDF beside a certificate; what hinders that is told and harms nothing else."""
    trouble: list[str] = []
    made: dict[str, Path | None] = {".html": None, ".pdf": None}
    for suffix, content in ((".html", html_from), (".pdf", pdf_from)):
        path = json_path.with_suffix(suffix)
        try:
            write_sheet(path, content(json_path))
            made[suffix] = path
        except CellError as error:
            trouble.append(str(error))
        except Exception:  # noqa: BLE001  the run is over and signed for: what only draws it must not spoil that
            _log.exception("%s could not be made", path)
            trouble.append(f"{path.name} could not be made; the log has the cause.")
    return PrintedFiles(made[".html"], made[".pdf"], " ".join(trouble))


def write_sheet(path: Path, content: str | bytes) -> None:
    """Write a page or a PDF, whole or not at all.

    Raises
    ------
    PrintingError
        It cannot be written there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, content, mode=SHARED_FILE)
    except OSError as error:
        raise PrintingError(
            make_message("{path} cannot be written: {strerror}.", path=path, strerror=error.strerror),
            remedy="Give a folder that may be written.",
        ) from error
