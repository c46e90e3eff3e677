"""The refusal of all guarded readers."""

from calibration.errors import CellError


class DocumentError(CellError, ValueError):
    """A document is no whole document of its format, or goes past a limit of its reader."""

    code = "usage"
