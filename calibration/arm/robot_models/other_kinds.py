"""Robots that people ask for by name and that are no single serial arm: why they are not listed, and what helps.

Which names these are is from memory of the makers' series; a wrong one costs a sentence, and no number depends on it.
"""

import re
from dataclasses import dataclass

from cellcal.calibration.message import make_message

_PLAIN = re.compile(r"[a-z]+|\d+")
_PARALLEL = re.compile(
    r"delta|flexpicker|flexpacker|hexapod|stewart|quattro(650|800)|hornet565|codian"
    r"|irb(360|365|390)(?!\d)|(^|fanuc)(m[123]ia|dr3ib|f[12]00ib)|mpp3|yf0?03|kr3d1200"
)
_LEVEL_WRIST = re.compile(
    r"palleti[sz]er|irb(460|660|760)(?!\d)|(^|fanuc)m410|kr\d+(r\d+)?pa(?![a-z])|mpl(?!80)\d|cp(130|180|300|500|700)l"
)
_TWO_ARMS = re.compile(r"yumi|irb140(00|50)(?!\d)|duaro|nextage|baxter")
RODS_ANSWER = "calibration/arm/robot_models/README.md, “Wrists that rods keep level”, shows one."


@dataclass(frozen=True, slots=True)
class OtherKind:
    """Why a robot is not in the catalogue, and what can be done."""

    reason: str
    remedy: str


_PARALLEL_ROBOT = OtherKind(
    "is a parallel robot: several chains move one plate. Catalogue, identification and recovery are for arms "
    "in which each joint carries the next.",
    "Its own errors are for its maker's calibration. Where its work stands needs no model: "
    "`cellcal simulate-cell workpiece`, from points that it touches.",
)
_LEVEL = OtherKind(
    "is a palletizer whose wrist stays level, by rods or by its controller; its numbers do not ship.",
    make_message(
        "Describe it by a model file of five joints, of which one only keeps the wrist level: {answer}",
        answer=RODS_ANSWER,
    ),
)


_ARMS_OF_ONE = OtherKind(
    "has arms whose numbers do not ship.",
    "Take each arm from the maker's description: `--robot 'cell.urdf?base=BODY&tip=LEFT_TOOL'`, and the other one "
    "with its own tip. Each is identified as a robot of its own, or both together by a layout with two robots "
    "(`deploy/layouts/`).",
)


def other_kind(words: str) -> OtherKind | None:
    """Return what is known of a robot that is no plain serial arm; None of any other name."""
    plain = "".join(_PLAIN.findall(words.lower()))
    if _PARALLEL.search(plain):
        return _PARALLEL_ROBOT
    if _TWO_ARMS.search(plain):
        return _ARMS_OF_ONE
    return _LEVEL if _LEVEL_WRIST.search(plain) else None
