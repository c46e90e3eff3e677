"""ABB's confdata ``[cf1,cf4,cf6,cfx]``: quarter turns of axes 1, 4 and 6, and which of eight postures.

A quadrant is 0 from 0 to 90 degrees, 1 from 90 to 180, -1 from 0 to -90. For serial-link arms cfx counts the three
singularities: 4 with the wrist's centre behind axis 1, 2 with it behind the lower arm, 1 with axis 5 negative
(RAPID reference manual, confdata). Arms with a parallelogram, whose axes 2 and 3 are coupled, do not use it.
"""

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.drivers.programs.arm_shape import arm_shape, sign_options

NEAR_RAD = np.deg2rad(0.01)  # an axis this near to a border is on both sides of it
NEAR_M = 1e-4
_TEXT = re.compile(r"\s*\[([^\[\]]*)\]\s*")
_AXES = (0, 3, 5)


class AbbConfigurations:
    """confdata of postures, as `drivers.programs.brands.ConfigurationRule`."""

    def matches_postures(
        self, model: RobotModel, joints: Array, texts: Sequence[str], *, turns: bool = True
    ) -> NDArray[np.bool_]:
        """Return (N,): whether postures are what the texts say; with ``turns=False`` but for whole turns."""
        is_stated, stated_numbers = _stated_numbers(texts)
        agreeing = np.ones(len(joints), dtype=bool)
        for k, axis in enumerate(_AXES):
            difference = [
                _quarter_turn(joints[:, axis] + side) - stated_numbers[:, k] for side in (-NEAR_RAD, NEAR_RAD)
            ]
            agreeing &= np.any([each == 0 if turns else each % 4 == 0 for each in difference], axis=0)
        for bit, (clear, is_set) in _posture_bits(model, joints, near=True):
            agreeing &= np.where(stated_numbers[:, 3] & bit, is_set, clear)
        agreeing |= ~is_stated
        return agreeing

    def keeps_posture(self, model: RobotModel, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Return (N,): whether cfx is that of the postures, and the wrist has not turned over.

        Axis 1 may be in any quadrant, axes 4 and 6 in the next one. An arm that does not use cfx keeps all quadrants.
        """
        shape = _posture_bits(model, joints, near=True)
        if not shape:
            return self.matches_postures(model, joints, texts, turns=False)
        is_stated, stated_numbers = _stated_numbers(texts)
        is_same = np.ones(len(joints), dtype=bool)
        for bit, (clear, is_set) in shape:
            is_same &= np.where(stated_numbers[:, 3] & bit, is_set, clear)
        for k, axis in ((1, 3), (2, 5)):
            is_same &= (_quarter_turn(joints[:, axis]) - stated_numbers[:, k]) % 4 != 2
        return is_same | ~is_stated

    def write_configurations(self, model: RobotModel, joints: Array, like: Sequence[str]) -> tuple[str, ...]:
        """Return the confdata of these postures; a text that states none stays."""
        shape = list(_posture_bits(model, joints, near=False))
        cfx = sum(
            (is_set.astype(np.int64) * bit for bit, (_, is_set) in shape), np.zeros(len(joints), np.int64)
        )
        quadrants = np.stack([_quarter_turn(joints[:, axis]) for axis in _AXES], axis=1)
        result = []
        for old, turned, posture in zip(like, quadrants.tolist(), cfx.tolist(), strict=True):
            stated = numbers_of(old)
            numbers = [*turned, posture if shape else (stated or (0, 0, 0, 0))[3]]
            result.append(old if stated is None else f"[{','.join(map(str, numbers))}]")
        return tuple(result)


def _stated_numbers(texts: Sequence[str]) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return whether texts state a confdata (N,), and which (N, 4)."""
    stated = [numbers_of(text) for text in texts]
    is_stated = np.array([numbers is not None for numbers in stated], dtype=bool)
    return is_stated, np.array([numbers or (0, 0, 0, 0) for numbers in stated], dtype=np.int64).reshape(-1, 4)


@lru_cache(maxsize=4096)  # a line of programs spells few postures, over and over
def numbers_of(text: str) -> tuple[int, int, int, int] | None:
    """Return cf1, cf4, cf6 and cfx; None for a text that is no confdata."""
    found = _TEXT.fullmatch(text)
    if found is None:
        return None
    try:
        numbers = [float(part) for part in found[1].split(",")]
    except ValueError:
        return None
    if len(numbers) != 4 or any(number % 1 or abs(number) > 1e6 for number in numbers):
        return None
    return int(numbers[0]), int(numbers[1]), int(numbers[2]), int(numbers[3])


def _quarter_turn(angle_rad: Array) -> NDArray[np.int64]:
    return np.floor(angle_rad / (0.5 * np.pi)).astype(np.int64)


def _posture_bits(
    model: RobotModel, joints: Array, *, near: bool
) -> list[tuple[int, tuple[NDArray[np.bool_], NDArray[np.bool_]]]]:
    """Return for each bit of cfx whether it may be clear and whether set; nothing for a parallelogram."""
    shape = arm_shape(model, joints)
    if model.joint_coupling[2, 1] != 0.0:
        return []
    length, angle = (NEAR_M, NEAR_RAD) if near else (0.0, 0.0)
    return [
        (4, sign_options(shape.forward_m, length)),
        (2, sign_options(shape.before_arm_m, length)),
        (1, sign_options(joints[:, 4], angle)),
    ]
