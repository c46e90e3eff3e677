"""A URScript file with joint moves, for a script node of a pendant.

Source: Universal Robots, The URScript Programming Language, e-Series, ``movej(q, a, v)``: v is the speed of the
leading axis [rad/s]. Not run on a robot by us.
"""

import math

from cellcal.drivers.wire.program_file import ProgramHeader, ProgramWriter, Way, lines_of

_ACCELERATION_RAD_S2 = 0.2


def write_script(header: ProgramHeader, way_rad: Way, speed_rad_s: float) -> str:
    """Return a script of one function that moves along the corners and ends."""
    remarks = [f"cellcal {header.token}, {header.robot}", *lines_of(header.warning, 100)]
    remarks.append(
        f"Joint moves, fastest joint {math.degrees(speed_rad_s):.2f} deg/s. "
        "Compare the joints before you run it, in T1."
    )
    moves = [
        f"  movej([{', '.join(f'{q:.6f}' for q in corner)}], a={_ACCELERATION_RAD_S2}, v={speed_rad_s:.6f})"
        for corner in way_rad
    ]
    lines = [*(f"# {line}" for line in remarks), f"def {header.name}():", *moves, "end", f"{header.name}()"]
    return "\n".join(lines) + "\n"


PROGRAM_WRITER = ProgramWriter(".script", write_script)
