"""KUKA's S and T: how the arm stands, and the sign of every axis.

S bit 0: the wrist's centre is behind axis 1 (overhead). Bit 1: the wrist is on the near side of the line through
axes 2 and 3, which for arms without offset between axes 3 and 4 means A3 >= 0. Bit 2: A5 < 0. Bits above
(4: taught on an absolutely accurate robot) say nothing of the posture and stay. T has one bit an axis, set where
its angle is negative.
"""

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.drivers.kuka.program_files.literals import state_text, state_value
from cellcal.drivers.programs.arm_shape import arm_shape, sign_options

NEAR_RAD = np.deg2rad(0.01)  # an axis this near to a border is on both sides of it
NEAR_M = 1e-4
_PART = re.compile(r"([ST])\s+('?\w+'?(?:\.0*)?)", re.IGNORECASE)
_POSTURE_BITS = 0b111


class KukaConfigurations:
    """S and T of postures, as `drivers.programs.brands.ConfigurationRule`."""

    def matches_postures(
        self, model: RobotModel, joints: Array, texts: Sequence[str], *, turns: bool = True
    ) -> NDArray[np.bool_]:
        """Return (N,): whether postures are what the texts say; with ``turns=False``, T is not asked."""
        shapes = _status_bits(model, joints)
        status = _stated_numbers(texts, "S")
        agreeing = np.ones(len(joints), dtype=bool)
        for bit, (clear, is_set) in enumerate(shapes):
            agreeing &= np.where(status >> bit & 1, is_set, clear) | (status < 0)
        if turns:
            signs, turn = sign_options(joints, NEAR_RAD), _stated_numbers(texts, "T")
            for axis in range(joints.shape[1]):
                agreeing &= np.where(turn >> axis & 1, signs[1][:, axis], signs[0][:, axis]) | (turn < 0)
        return agreeing

    def keeps_posture(self, model: RobotModel, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Return (N,): whether the flags of the texts are those of the postures."""
        return self.matches_postures(model, joints, texts, turns=False)

    def write_configurations(self, model: RobotModel, joints: Array, like: Sequence[str]) -> tuple[str, ...]:
        """Return S and T of these postures; what an old text does not state stays unstated."""
        status = sum(
            is_set.astype(int) << bit
            for bit, (_, is_set) in enumerate(_status_bits(model, joints, near=False))
        )
        turn = (joints < 0).astype(int) @ (1 << np.arange(joints.shape[1]))
        return tuple(
            _write_configuration(old, int(flags), int(signs))
            for old, flags, signs in zip(like, np.broadcast_to(status, len(joints)), turn, strict=True)
        )


def parts_of(text: str) -> dict[str, str] | None:
    """Return S and T as written; None for a text that is something else."""
    parts: dict[str, str] = {}
    for piece in text.split(",") if text.strip() else ():
        found = _PART.fullmatch(piece.strip())
        if found is None or found[1].upper() in parts or state_value(found[2]) is None:
            return None
        parts[found[1].upper()] = found[2]
    return parts


def _status_bits(
    model: RobotModel, joints: Array, *, near: bool = True
) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """Return for bits 0, 1 and 2 whether they may be clear, and whether they may be set."""
    shape = arm_shape(model, joints)
    length, angle = (NEAR_M, NEAR_RAD) if near else (0.0, 0.0)
    before, behind = sign_options(shape.before_arm_m, length)
    return [sign_options(shape.forward_m, length), (behind, before), sign_options(joints[:, 4], angle)]


def _stated_numbers(texts: Sequence[str], name: str) -> NDArray[np.int64]:
    """Return (N,): S or T, -1 where a text does not state it."""
    return np.array([_stated_number(text, name) for text in texts], dtype=np.int64)


@lru_cache(maxsize=4096)  # a line of programs spells few postures, over and over
def _stated_number(text: str, name: str) -> int:
    part = (parts_of(text) or {}).get(name)
    value = None if part is None else state_value(part)
    return -1 if value is None else value


def _write_configuration(old: str, flags: int, signs: int) -> str:
    parts = parts_of(old)
    if not parts:
        return old
    if "S" in parts:
        other_bits = (state_value(parts["S"]) or 0) & ~_POSTURE_BITS
        parts["S"] = state_text(parts["S"], other_bits | flags)
    if "T" in parts:
        parts["T"] = state_text(parts["T"], signs)
    return ",".join(f"{name} {value}" for name, value in parts.items())
