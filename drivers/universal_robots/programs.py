"""Program files of Universal Robots: scripts, programs of PolyScope, and installations."""

from drivers.programs.brands import ProgramBrand
from drivers.universal_robots.script_program import read_script

BRAND = ProgramBrand("universal_robots", (".script",), read_script, None)
