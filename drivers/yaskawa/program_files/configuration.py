"""///RCONF: which posture reaches a pose. The first six numbers are known; the others are kept.

1 no-flip, 2 lower arm, 3 rear, 4 R, 5 T, 6 S beyond half a turn. Source: Motoman NX100 and DX100, data transmission
function, section 4.1. Which of the two postures of a wrist is "flip" depends on the controller: on an NX100 the one
with -90 < R <= 90 deg (and whole turns from there; operator's manual, section 3.9), on a YRC1000 the one with B above
zero (20 postures of one, tests/data/yaskawa_ar2010_yrc1000.csv). They are told apart by how many numbers they write.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message
from cellcal.drivers.programs.arm_shape import arm_shape, sign_options

NEAR_RAD = np.deg2rad(0.01)  # an axis this near to a border is on both sides of it
NEAR_M = 1e-4
_KNOWN_FLAGS = 6
_OLDER = 8  # numbers of an XRC's and an NX100's RCONF; a DX100's and all later ones have 24
_SHARED = "it would need another RCONF, {} in place of {}, and the job states it once for many positions"
_TURNS = {3: 3, 4: 5, 5: 0}  # place in RCONF: axis R, T, S


class JobConfigurations:
    """RCONF of postures, as `drivers.programs.brands.ConfigurationRule`."""

    def matches_postures(
        self, model: RobotModel, joints: Array, texts: Sequence[str], *, turns: bool = True
    ) -> NDArray[np.bool_]:
        """Return (N,): whether postures (N, 6) [rad] are what the texts say."""
        flags = _stated_numbers(texts, len(joints))
        agreeing = np.ones(len(joints), dtype=bool)
        for place, (clear, is_set) in _border_flags(model, joints, texts, near=True).items():
            if turns or place not in _TURNS:
                stated = flags[:, place]
                agreeing &= (stated < 0) | np.where(stated == 1, is_set, clear)
        return agreeing

    def keeps_posture(self, model: RobotModel, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Return (N,): whether the flags of the texts are those of the postures."""
        return self.matches_postures(model, joints, texts, turns=False)

    def write_configurations(self, model: RobotModel, joints: Array, like: Sequence[str]) -> tuple[str, ...]:
        """Return RCONF of these postures; numbers whose meaning is not known stay."""
        borders = _border_flags(model, joints, like, near=False)
        sets = {place: is_set & ~clear for place, (clear, is_set) in borders.items()}
        open_ = {place: is_set & clear for place, (clear, is_set) in borders.items()}
        texts = []
        for i, old in enumerate(like):
            numbers = old.split(",") if old.strip() else []
            for place, value in sets.items():
                if place < len(numbers) and not open_[place][i]:
                    numbers[place] = _in_style_of(numbers[place], str(int(value[i])))
            texts.append(",".join(numbers))
        return tuple(texts)

    def refuses_change(self, old: str, new: str) -> str:
        """Return why a position cannot take another RCONF."""
        return make_message(_SHARED, new, old)


def _border_flags(
    model: RobotModel, joints: Array, texts: Sequence[str], *, near: bool
) -> dict[int, tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Return for each known place of texts (N,) whether it may be 0, and whether it may be 1."""
    shape = arm_shape(model, joints)
    length, angle = (NEAR_M, NEAR_RAD) if near else (0.0, 0.0)
    front, rear = sign_options(shape.forward_m, length)
    upper, lower = sign_options(shape.before_arm_m, length)
    older = np.array([text.count(",") < _OLDER for text in texts], dtype=bool)
    flip, no_flip = sign_options(np.where(older, np.cos(joints[:, 3]), np.sin(joints[:, 4])), np.sin(angle))
    found = {0: (flip, no_flip), 1: (upper | rear, lower | rear), 2: (front, rear)}
    for place, axis in _TURNS.items():
        found[place] = sign_options(np.pi - np.abs(joints[:, axis]), angle)
    return found


def _stated_numbers(texts: Sequence[str], count: int) -> NDArray[np.int64]:
    """Return (N, 6): the flags, -1 where a text does not state one."""
    flags = np.full((count, _KNOWN_FLAGS), -1, dtype=np.int64)
    for i, text in enumerate(texts):
        for place, number in enumerate(text.split(",")[:_KNOWN_FLAGS] if text.strip() else ()):
            if number.strip() in ("0", "1"):
                flags[i, place] = int(number)
    return flags


def _in_style_of(old: str, new: str) -> str:
    return old.replace(old.strip(), new, 1)
