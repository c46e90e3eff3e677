"""Guarded readers: the only way from the bytes of a file or a message to numbers and words, one for each format.

Each has limits (size, depth, digits) and one kind of refusal, `DocumentError`. A test refuses other readers.
"""

from cellcal.calibration.documents.errors import DocumentError

__all__ = ["DocumentError"]
