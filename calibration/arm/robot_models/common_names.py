"""What people call robots beside the names of the catalogue: brands, earlier names, kinds and numbers of axes."""

import re
from collections.abc import Mapping

# A word, and words that stand in the catalogue's name, title, maker or family of each robot that it means.
COMMON_NAMES: Mapping[str, tuple[str, ...]] = {
    "panda": ("frankafer",),  # franka_description calls the arm that was sold as Panda "fer"
    "emika": ("franka",),
    "frankaemika": ("franka",),
    "research": ("fr3",),
    "production": ("fp3",),
    "melfa": ("mitsubishi",),
    "omron": ("techman",),
}
# A robot as it was sold, in plain letters, and its name in the catalogue: such a name alone loads it.
SOLD_AS: Mapping[str, str] = dict.fromkeys(
    ("panda", "frankapanda", "frankaemikapanda", "emikapanda"), "franka_fer"
)
FILLER_WORDS = frozenset(
    ("arm", "robot", "robots", "robotic", "industrial", "series", "model", "the")
)  # tell no robot
_NUMBERS = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_AXES = re.compile(rf"([1-9]|{'|'.join(_NUMBERS)})(?:axis|axes|dof|achs\w*|ejes?)")
_KINDS = {"scara": "scara", "positioner": "positioner", "linkage": "linkage", "parallelogram": "linkage"}


def axes_meant(word: str) -> int | None:
    """Return the number of axes that a word asks for, such as ``7axis``; None of any other."""
    found = _AXES.fullmatch(word)
    if not found:
        return None
    return _NUMBERS.index(found[1]) + 1 if found[1] in _NUMBERS else int(found[1])


def kind_meant(word: str) -> str | None:
    """Return the kind of arm that a word asks for, such as ``scara``; None of any other."""
    return _KINDS.get(word)
