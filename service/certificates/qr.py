"""The square code of a certificate: its id and its hash, to compare a printed copy with the JSON file."""

import io

import segno

from cellcal.service.certificates.blocks import PictureBlock

_QUIET_ZONE = 4  # modules of white around it, after ISO/IEC 18004


def code_text(file_stem: str, sha256: str) -> str:
    """Return what the code says; `cellcal verify` prints the same hash."""
    return f"cellcal {file_stem} sha256:{sha256}"


def code_of(file_stem: str, sha256: str) -> PictureBlock:
    """Draw the code of a certificate or a refusal record."""
    content = code_text(file_stem, sha256)
    file = io.BytesIO()
    segno.make(content, error="m", micro=False, boost_error=False).save(
        file, kind="svg", border=_QUIET_ZONE, light="#ffffff", omitsize=True, xmldecl=False, nl=False,
        svgclass=None, lineclass=None,
    )  # fmt: skip
    return PictureBlock(file.getvalue().decode(), f"Square code that says: {content}", "id and hash")
