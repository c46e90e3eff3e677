"""DCSVRFY.DG: signature numbers of the safety settings (DCS). One changes with every setting that it covers.

::

    --- Signature number (Dec) -------------
                    Current        Latch
    2 Base:        -1149932377  -1149932377
      Time:27-JUL-21 19:49  15-JUL-21 21:30
       Mastering:   -983540984
    3 Pos./Speed:   1945160182   1945160182
"""

import re
from collections.abc import Mapping

from cellcal.drivers.fanuc.controller_files.report_text import decode_report

_SIGNATURES = re.compile(r"-*\s*SIGNATURE NUMBER\b", re.IGNORECASE)
_NUMBER = re.compile(
    r"\s*(?:\d+\s+)?([A-Z][A-Z./ ]*?)\s*:\s*(-?\d{1,11})(?:\s+-?\d{1,11})?\s*\Z", re.IGNORECASE
)


def read_dcs_signatures(data: bytes, file: str = "dcsvrfy.dg") -> Mapping[str, int]:
    """Return the present signature numbers by their names; none where the report holds none.

    Raises
    ------
    ProgramFileError
        It is empty or no text.
    """
    lines = decode_report(file, data)[:-1]  # a last line without an end may be cut inside a number
    start = next((at for at, line in enumerate(lines) if _SIGNATURES.match(line)), len(lines))
    found = (_NUMBER.match(line) for line in lines[start:])
    return {match[1]: int(match[2]) for match in found if match is not None}
