"""Files that were cut off: what begins a module or a routine, and no word that ends it behind."""

import re

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.spans import ProgramText


def refuse_missing_end(source: ProgramText, begins: re.Pattern[str], ends: re.Pattern[str]) -> None:
    """Refuse a file whose last part has no end: points behind the cut are missing, and its last number may be short.

    A piece of a program that begins nothing is none of these.

    Raises
    ------
    ProgramFileError
        The last match of ``begins`` has no match of ``ends`` behind it.
    """
    last = None
    for last in begins.finditer(source.text):  # noqa: B007  the last one counts
        pass
    if last is not None and ends.search(source.text, last.end()) is None:
        raise source.error_at(
            last.start(),
            make_message("{begin} has no end: the file is cut short.", begin=" ".join(last[0].split())),
            remedy="Fetch it from the controller again.",
        )
