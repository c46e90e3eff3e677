"""Program files of Universal Robots: scripts, and programs and installations of PolyScope."""

from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.drivers.universal_robots.program_files.feature_variables import says_nothing
from cellcal.drivers.universal_robots.program_files.script_called import NAMES
from cellcal.drivers.universal_robots.program_files.script_program import read_script
from cellcal.drivers.universal_robots.program_files.urp_installation import read_installation
from cellcal.drivers.universal_robots.program_files.urp_program import read_urp

_PACKED = (b"\x1f\x8b", b"<")  # gzip, or XML without it


def read_program_file(name: str, data: bytes) -> ProgramFile:
    """Read any of the three; what is packed is told from a script by its first bytes."""
    if name.lower().endswith(".installation"):
        return read_installation(name, data)
    if data.startswith(_PACKED) or name.lower().endswith(".urp"):
        return read_urp(name, data)
    return read_script(name, data)


BRAND = ProgramBrand(
    brand="universal_robots",
    suffixes=(".script", ".urp", ".installation"),
    read=read_program_file,
    configurations=None,
    tells=True,
    routine_names=NAMES,
    says=says_nothing,
)
