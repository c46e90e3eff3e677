"""What people call robots beside the names of the catalogue: brands, earlier names, kinds and numbers of axes."""

import re
from collections.abc import Mapping

# A word, and words that stand in the catalogue's name, title, maker or family of each robot that it means.
COMMON_NAMES: Mapping[str, tuple[str, ...]] = {
    "panda": ("frankafer",),  # franka_description calls the arm that was sold as Panda "fer"
    "emika": ("franka",),
    "research": ("fr3",),
    "production": ("fp3",),
    "melfa": ("mitsubishi",),
    "omron": ("techman",),
}
FILLER_WORDS = frozenset(
    ("arm", "robot", "robots", "robotic", "industrial", "series", "model", "the")
)  # tell no robot
_AXES = re.compile(r"([1-9])(?:axis|axes|dof|achs\w*|ejes?)")
_KINDS = {"scara": "scara", "positioner": "positioner", "linkage": "linkage", "parallelogram": "linkage"}


def axes_meant(word: str) -> int | None:
    """Return the number of axes that a word asks for, such as ``7axis``; None of any other."""
    found = _AXES.fullmatch(word)
    return int(found[1]) if found else None


def kind_meant(word: str) -> str | None:
    """Return the kind of arm that a word asks for, such as ``scara``; None of any other."""
    return _KINDS.get(word)
