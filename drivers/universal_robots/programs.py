"""Program files of Universal Robots: scripts, and programs of PolyScope."""

from drivers.programs.brands import ProgramBrand
from drivers.programs.positions import ProgramFile
from drivers.universal_robots.script_program import read_script
from drivers.universal_robots.urp_program import read_urp


def read(name: str, data: bytes) -> ProgramFile:
    """Read either kind; a ``.urp`` is told by its first bytes, not by its name."""
    packed = data.startswith((b"\x1f\x8b", b"<")) or name.lower().endswith(".urp")
    return read_urp(name, data) if packed else read_script(name, data)


BRAND = ProgramBrand("universal_robots", (".script", ".urp"), read, None)
