"""gzip within a limit: unpacking stops before a bomb has filled the memory."""

import zlib

from cellcal.calibration.documents.errors import DocumentError
from cellcal.calibration.message import make_message


def unpack_gzip(packed: bytes, most_bytes: int) -> bytes:
    """Return what one gzip member holds.

    Raises
    ------
    DocumentError
        Damaged, cut short, followed by something, or larger than ``most_bytes``.
    """
    inflate = zlib.decompressobj(zlib.MAX_WBITS | 16)
    try:
        found = inflate.decompress(packed, most_bytes + 1)
    except zlib.error as error:
        raise DocumentError(
            make_message("the gzip data are damaged ({error}).", error=error), remedy="Fetch the file again."
        ) from error
    if len(found) > most_bytes:
        raise DocumentError(f"it unpacks to more than {most_bytes} bytes.", remedy="Fetch the file again.")
    if not inflate.eof:
        raise DocumentError("the gzip data end too soon.", remedy="Fetch the file again.")
    if inflate.unused_data:
        raise DocumentError("something follows the gzip data.", remedy="Fetch the file again.")
    return found
