"""CONFIG of a six-axis FANUC: ``'N U T, 0, 0, 0'`` from the joints, and the other way to check it.

| letter | says | basis |
|---|---|---|
| N, F | no flip, flip: J5 <= 0 or J5 > 0 | measured |
| U, D | the wrist centre on this or that side of the line from shoulder (axis 2) to elbow (axis 3) | measured |
| T, B | the wrist centre in front of or behind axis 1 | measured |
| three numbers | whole turns of J1, J4, J6: 0 inside +-180 deg, 1 from 180 deg on, -1 from -180 deg on | measured |

"Measured" is 16 joint sets of an M-20iD/25 that a virtual controller (ROBOGUIDE) turned into poses with CONFIG,
published with the program LeroyDu56/CrossArm; the tests recompute poses and letters. The side that is U and T is
the one of all joints zero. Inferred, not measured: that other six-axis arms with a wrist whose axes meet follow
the same rule, and which side a pose on the border is on. L and R belong to other arms (SCARA).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, cross_product, frames_of_placements
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.message import make_message

_TURNING = [0, 3, 5]  # J1, J4, J6
_WRIST = 4  # the frame whose origin is the wrist's centre
_NEAR_RAD = 1e-5  # measured: within 0.0004 deg of 180 the controller says turn 1, from 0.0007 deg on 0
_NEAR_M = 1e-6  # so close to the singularity either letter is right
_NUMBER = re.compile(r"-?\d+")
_PAIRS = (("N", "F"), ("U", "D"), ("T", "B"))


@dataclass(frozen=True, slots=True)
class _ConfigurationText:
    """A parsed configuration: for each pair +1 for the first letter, -1 for the second, 0 for nothing; the turns."""

    flags: tuple[int, int, int]
    turns: tuple[int | None, ...]

    @classmethod
    def from_text(cls, text: str) -> "_ConfigurationText":
        letters, *numbers = text.split(",")
        flags = tuple((first in letters) - (second in letters) for first, second in _PAIRS)
        found = [int(number) if _NUMBER.fullmatch(number.strip()) else None for number in numbers]
        turns = (*found, None, None, None)[:3]
        return cls((flags[0], flags[1], flags[2]), turns)


class FanucConfigurations:
    """`drivers.programs.brands.ConfigurationRule` of six-axis FANUC arms."""

    def matches_postures(
        self, model: RobotModel, joints: Array, texts: Sequence[str], *, turns: bool = True
    ) -> NDArray[np.bool_]:
        """Return (N,): whether postures (N, 6) [rad] are what the texts say; ``turns=False`` looks at flags only.

        A posture on the border between two letters or two turn numbers agrees with both.
        """
        joints = _six_joints(model, joints)
        sides, border = _posture_sides(model, joints)
        number = {text: i for i, text in enumerate(dict.fromkeys(texts))}  # a line of points has few of them
        at = np.array([number[text] for text in texts], dtype=np.intp)
        stated = [_ConfigurationText.from_text(text) for text in number]
        flags = np.array([each.flags for each in stated], dtype=int).reshape(-1, 3)[at]
        fits = ((flags == 0) | border | (flags == sides)).all(axis=1)
        if turns:
            stated_turns = np.array([each.turns for each in stated], dtype=float).reshape(-1, 3)[
                at
            ]  # None becomes NaN
            low, high = (
                _whole_turns(joints[:, _TURNING], margin_rad) for margin_rad in (-_NEAR_RAD, _NEAR_RAD)
            )
            fits &= (np.isnan(stated_turns) | (stated_turns == low) | (stated_turns == high)).all(axis=1)
        return np.asarray(fits, dtype=np.bool_)

    def keeps_posture(self, model: RobotModel, joints: Array, texts: Sequence[str]) -> NDArray[np.bool_]:
        """Return (N,): whether the flags of the texts are those of the postures."""
        return self.matches_postures(model, joints, texts, turns=False)

    def write_configurations(self, model: RobotModel, joints: Array, like: Sequence[str]) -> tuple[str, ...]:
        """Return the texts that say these postures (N, 6) [rad], in the spelling of the N old texts.

        What an old text leaves open stays open.
        """
        joints = _six_joints(model, joints)
        sides, _ = _posture_sides(model, joints)
        turns = _whole_turns(joints[:, _TURNING], _NEAR_RAD).astype(int)
        return tuple(
            _write_configuration(text, flags, numbers)
            for text, flags, numbers in zip(like, sides.tolist(), turns.tolist(), strict=True)
        )


def _write_configuration(text: str, flags: Sequence[int], turns: Sequence[int]) -> str:
    letters, comma, numbers = text.partition(",")
    for pair, flag in zip(_PAIRS, flags, strict=True):
        letters = re.sub("[" + "".join(pair) + "]", pair[0] if flag > 0 else pair[1], letters)
    rest = iter(turns)
    return letters + comma + _NUMBER.sub(lambda old: str(next(rest, old[0])), numbers)


def _six_joints(model: RobotModel, joints: Array) -> Array:
    joints = np.atleast_2d(np.asarray(joints, dtype=float))
    if (
        model.axis_count != 6
        or model.sliding is not None
        or joints.shape[1] != 6
        or not np.isfinite(joints).all()
    ):
        raise CalibrationError(
            make_message(
                "{model_name}: the configuration of a FANUC is known for six finite joints, not {shape}.",
                model_name=model.label,
                shape=joints.shape[1],
            )
        )
    return joints


def _posture_sides(model: RobotModel, joints: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return (N, 3) +1 or -1 for N/F, U/D, T/B, and where a posture is on the border of both."""
    beside, before = _elbow_and_front(model, np.vstack([joints, np.zeros(6)]))
    values = np.stack(
        [-joints[:, 4], beside[:-1] * np.sign(beside[-1]), before[:-1] * np.sign(before[-1])], axis=1
    )
    sides = np.where(values > 0, 1, -1)
    sides[:, 0] = np.where(joints[:, 4] > 0, -1, 1)
    return sides, np.abs(values) < [_NEAR_RAD, _NEAR_M, _NEAR_M]


def _elbow_and_front(model: RobotModel, joints: Array) -> tuple[Array, Array]:
    """Return how far the wrist centre is beside the line shoulder - elbow, and before axis 1 [m], signs arbitrary."""
    angles = model.joint_coupling @ joints.T + model.theta0_rad[:, None]
    rotations, origins = frames_of_placements(model.placements[: _WRIST + 1], angles[:_WRIST])
    across = rotations[1, :, 2]
    shoulder, elbow, wrist = origins[1], origins[2], origins[_WRIST]
    upper = elbow - shoulder
    upper = upper - _dot_product(upper, across) * across
    beside = _dot_product(cross_product(upper, wrist - shoulder), across) / np.sqrt(
        _dot_product(upper, upper)
    )
    return beside, _dot_product(wrist - origins[0], cross_product(across, rotations[0, :, 2]))


def _dot_product(a: Array, b: Array) -> Array:
    found: Array = np.einsum("in,in->n", a, b)
    return found


def _whole_turns(angles_rad: Array, margin_rad: float) -> Array:
    """Return how many whole turns beyond +-180 deg; the border itself counts as beyond with a margin above zero."""
    size = np.floor((np.abs(angles_rad) + np.pi + margin_rad) / (2 * np.pi))
    return np.asarray(np.sign(angles_rad) * size, dtype=float)
