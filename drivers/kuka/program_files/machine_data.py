"""What a controller's own lists say of its bases: where its robot stands, and which bases something carries.

``$MACHINE.DAT`` has the robot's root in the world, in which bases stand; ``$CONFIG.DAT`` has the machine that each
base is on, which the inline forms look at (BAS.SRC, FRAMES) and ``$BASE=BASE_DATA[n]`` does not.
"""

import re
from collections.abc import Mapping

from cellcal.calibration.geometry import Pose
from cellcal.drivers.kuka.program_files.patterns import B

ROOT = "$robroot"  # among the bases that $MACHINE.DAT declares for all files of its cell
ROOT_SET = "a program sets where the robot stands ($ROBROOT) while it runs"
SET = "SET $ROBROOT"  # what a program says to all of its cell
CARRIED = "CARRIED"  # before the number of a base that an external axis, a conveyor or another robot carries
_ON_TRACK = re.compile(r"\bET\d\s+#ERSYS\b", re.IGNORECASE)
_FRAME_OF = re.compile(
    rf"^{B}*+MACHINE_FRAME_DAT{B}*+\[{B}*+(\d+){B}*+\]{B}*+=[^\n]*?\bMACH_DEF_INDEX{B}++(\d+)",
    re.IGNORECASE | re.MULTILINE,
)
_MACHINE = re.compile(
    rf"^{B}*+MACHINE_DEF{B}*+\[{B}*+(\d+){B}*+\]{B}*+=(?=[^\n]*?\bCOOP_KRC_INDEX{B}++(\d+))"
    rf"[^\n]*?\bMECH_TYPE{B}++#(\w+)",
    re.IGNORECASE | re.MULTILINE,
)


def root_among(frames: Mapping[str, Pose | None], text: str) -> dict[str, Pose]:
    """Return the robot's root in the world as a base, of FRAMEs that a list declares; none where a track has it."""
    root = frames.get("$ROBROOT")
    is_elsewhere = root is not None and root != Pose((0.0, 0.0, 0.0)) and _ON_TRACK.search(text) is None
    return {ROOT: root} if root is not None and is_elsewhere else {}


def carried_bases(text: str) -> frozenset[str]:
    """Return the numbers of the bases that inline forms take from an external axis, a conveyor or another robot."""
    standing = {"0"} | {
        number
        for number, cooperating, kind in _MACHINE.findall(text)
        if kind.upper() == "NONE" or (kind.upper() == "ROBOT" and cooperating == "1")
    }
    return frozenset(base for base, machine in _FRAME_OF.findall(text) if machine not in standing)
