"""Universal Robots' kinematics, as controllers and ROS keep them: three forms, in and out.

``calibration.conf`` holds deltas to the nominal table, the primary interface the absolute table, both standard
DH; ROS's YAML holds six frames. Whose arm a YAML belongs to is proved by the hash of the absolute table.
Nothing here writes to a controller.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import DhTable, RobotModel
from cellcal.calibration.arm.standard_dh import standard_dh
from cellcal.calibration.arm.ur_factory import calibration_hash, factory_model, parse_calibration_conf
from cellcal.calibration.documents.plain_numbers import parse_number
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, homogeneous_matrix, inverse_transform, is_rigid
from cellcal.calibration.orientation import elementary_rotation, euler_angles, euler_rotation

ROS_FRAMES = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
LINEARISED = 2  # calibration status: 0 not initialised, 1 not linearised, 2 linearised
_ROBOT_STATE = 16
_KINEMATICS = 5
_HEADER = struct.Struct(">iB")
_SUB_HEADER = struct.Struct(">IB")
_BODY = struct.Struct(">6I24dI")
_LONGEST_MESSAGE = 1 << 20
_ROS_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True, eq=False)
class UrKinematics:
    """An arm's own table, absolute standard DH, with what the controller says about it."""

    table: DhTable
    joint_checksum: tuple[int, ...] = ()
    status: int = LINEARISED

    @property
    def factory_hash(self) -> str:
        """The name that proves to which arm a file belongs."""
        return calibration_hash(self.table)


@dataclass(frozen=True, eq=False)
class RosKinematics:
    """The frames of ROS's kinematics file: each joint's frame in the one before it, at angle zero."""

    frames: Array  # (6, 4, 4)
    hash: str


def read_calibration_conf(text: str, nominal: RobotModel) -> UrKinematics:
    """Read a controller's ``calibration.conf``: deltas to the nominal table of its type."""
    read = parse_calibration_conf(text)
    status = LINEARISED if read.linearised else 1
    return UrKinematics(read.to_absolute(_dh_table(nominal)), read.joint_checksum, status)


def write_calibration_conf(kinematics: UrKinematics, nominal: RobotModel) -> str:
    """Write the form of ``calibration.conf``; the checksum line is left out where it is unknown."""
    deltas = kinematics.table.to_rows() - _dh_table(nominal).to_rows()
    columns = {"theta": 0, "a": 2, "d": 1, "alpha": 3}
    lines = ["[mounting]"]
    for name, column in columns.items():
        lines.append(f"delta_{name} = [ {', '.join(repr(float(v)) for v in deltas[:, column])}]")
    if kinematics.joint_checksum:
        lines.append(f"joint_checksum = [ {', '.join(f'0x{v:08x}' for v in kinematics.joint_checksum)}]")
    lines.append(
        f"calibration_status = {kinematics.status} # 0 == notInitialized / 1 == notLinearised / 2 == Linearised"
    )
    return "\n".join(lines) + "\n"


def read_primary_kinematics(stream: bytes) -> UrKinematics:
    """Find the kinematics in bytes of the primary interface, port 30001: whole messages from the first on.

    Raises
    ------
    CalibrationError
        No kinematics in it, a message cut short, or numbers that are not finite.
    """
    for body in _sub_packages(stream):
        if len(body) != _BODY.size:
            raise CalibrationError(
                f"the kinematics of the primary interface have {len(body)} bytes, not {_BODY.size}"
            )
        values = _BODY.unpack(body)
        theta, a, d, alpha = np.reshape(values[6:30], (4, 6))
        rows = np.array([theta, d, a, alpha]).T
        if not np.isfinite(rows).all():
            raise CalibrationError("the kinematics of the primary interface are not finite")
        return UrKinematics(DhTable.from_rows(rows), tuple(values[:6]), int(values[30]))
    raise CalibrationError(
        "no kinematics in these bytes.",
        remedy="Record port 30001 from the moment of connecting: the first message holds them.",
    )


def write_primary_kinematics(kinematics: UrKinematics) -> bytes:
    """Return one robot-state message that holds nothing but the kinematics."""
    rows = kinematics.table.to_rows()
    checksum = kinematics.joint_checksum or (0xFFFFFFFF,) * 6
    columns = [rows[:, i] for i in (0, 2, 1, 3)]
    body = _BODY.pack(*checksum, *np.concatenate(columns), kinematics.status)
    package = _SUB_HEADER.pack(_SUB_HEADER.size + len(body), _KINEMATICS) + body
    return _HEADER.pack(_HEADER.size + len(package), _ROBOT_STATE) + package


def read_ros_kinematics(text: str) -> RosKinematics:
    """Read the YAML that ``ur_calibration`` writes.

    Its angles are Rx(roll) Ry(pitch) Rz(yaw), as ur_calibration takes them from its matrices; a description
    in URDF reads the same three numbers in the other order and is off by micrometres.

    Raises
    ------
    CalibrationError
        A frame or a number is missing, twice there, or not finite.
    """
    values = _yaml_leaves(text)
    numbers = []
    for frame in ROS_FRAMES:
        for key in _ROS_KEYS:
            path = f"kinematics.{frame}.{key}"
            numbers.append(_parse_finite(path, values.get(path)))
    xyz, angles = np.split(np.reshape(numbers, (6, 6)), 2, axis=1)
    frames = np.array(
        [homogeneous_matrix(euler_rotation("xyz", a), p) for a, p in zip(angles, xyz, strict=True)]
    )
    return RosKinematics(frames, values.get("kinematics.hash", ""))


def write_ros_kinematics(kinematics: RosKinematics) -> str:
    """Write the YAML form, with all digits."""
    lines = ["kinematics:"]
    for name, frame in zip(ROS_FRAMES, kinematics.frames, strict=True):
        numbers = [*frame[:3, 3], *euler_angles("xyz", frame[:3, :3])]
        lines.append(f"  {name}:")
        lines += [f"    {key}: {float(v)!r}" for key, v in zip(_ROS_KEYS, numbers, strict=True)]
    lines.append(f"  hash: {kinematics.hash}")
    return "\n".join(lines) + "\n"


def ros_frames(model: RobotModel) -> Array:
    """Return the frames (6, 4, 4) that ROS wants of an arm with a DH table; the last link's end is not in them."""
    rows, base = _dh_table(model).to_rows(), model.placements[0]
    rest = rows.copy()
    rest[:, 1] = 0.0
    before = np.concatenate([base[None], DhTable.from_rows(rest).to_placements()[:-1]])
    turns = [
        homogeneous_matrix(elementary_rotation("z", np.array(row[0])), np.array([0.0, 0.0, row[1]]))
        for row in rows
    ]
    return np.array([b @ t for b, t in zip(before, turns, strict=True)])


def model_of_ros(kinematics: RosKinematics, nominal: RobotModel) -> RobotModel:
    """Return the arm of ROS's frames, as a table near the nominal one.

    Raises
    ------
    CalibrationError
        The frames belong to another type of arm.
    """
    frames = kinematics.frames
    if frames.shape != (6, 4, 4) or not is_rigid(frames):
        raise CalibrationError("a UR arm has six frames")
    # The first frame's turn and height commute with joint 1 and become part of its row.
    carried = inverse_transform(nominal.placements[0]) @ frames[0]
    tilt = np.abs(carried[:2, 2]).max() + np.abs(carried[:2, 3]).max()
    if tilt > 1e-9:
        raise CalibrationError("joint 1 of these frames is not upright in the base")
    end = nominal.placements[6].copy()
    end[:3, 3] -= _dh_table(nominal).d_m[5] * np.array([0.0, 0.0, 1.0])
    placements = np.array([nominal.placements[0], carried @ frames[1], *frames[2:], end])
    chain = RobotModel(
        name=f"{nominal.name}_ros",
        title=f"{nominal.title}, from ROS kinematics",
        dh=None,
        placements=placements,
        theta0_rad=np.zeros(6),
        joint_coupling=nominal.joint_coupling,
        lower_rad=nominal.lower_rad,
        upper_rad=nominal.upper_rad,
        max_speed_rad_s=nominal.max_speed_rad_s,
        joint_names=nominal.joint_names,
        gravity_in_base=nominal.gravity_in_base,
    )
    return factory_model(nominal, standard_dh(chain, nominal).table, name=chain.name)


def _dh_table(model: RobotModel) -> DhTable:
    if model.dh is None or model.axis_count != 6:
        raise CalibrationError(f"{model.label}: a UR arm has a table of six rows")
    return model.dh


def _sub_packages(stream: bytes) -> Iterator[bytes]:
    """Yield the bodies of all kinematics packages in whole messages."""
    at = 0
    while at + _HEADER.size <= len(stream):
        length, kind = _HEADER.unpack_from(stream, at)
        if not _HEADER.size <= length <= _LONGEST_MESSAGE:
            raise CalibrationError("these bytes are not of the primary interface: a length is impossible")
        message = stream[at : at + length]
        if kind == _ROBOT_STATE:
            yield from _kinematics_of(message, whole=len(message) == length)
        at += length


def _kinematics_of(message: bytes, *, whole: bool) -> Iterator[bytes]:
    at = _HEADER.size
    while at + _SUB_HEADER.size <= len(message):
        length, kind = _SUB_HEADER.unpack_from(message, at)
        if length < _SUB_HEADER.size or (at + length > len(message) and whole):
            raise CalibrationError(
                "these bytes are not of the primary interface: a package is longer than its message"
            )
        if kind == _KINEMATICS:
            yield message[at + _SUB_HEADER.size : at + length]
        at += length


def _yaml_leaves(text: str) -> dict[str, str]:
    """Return the scalars of nested block mappings by dotted path: all that such a file may hold."""
    leaves: dict[str, str] = {}
    path: list[tuple[int, str]] = []
    for line in text.splitlines():
        bare = re.sub(r"(^|\s)#.*$", "", line).rstrip()
        if not bare or bare == "---":
            continue
        found = re.fullmatch(r"( *)([A-Za-z_]\w*):(?: +(.+))?", bare)
        if found is None:
            raise CalibrationError(f"not a kinematics file of ur_calibration: {bare.strip()!r}")
        indent = len(found[1])
        while path and path[-1][0] >= indent:
            path.pop()
        path.append((indent, found[2]))
        name = ".".join(key for _, key in path)
        if name in leaves:
            raise CalibrationError(f"a kinematics file holds {name} twice")
        if found[3] is not None:
            leaves[name] = found[3].strip().strip("'\"")
    return leaves


def _parse_finite(path: str, text: str | None) -> float:
    if text is None:
        raise CalibrationError(f"the kinematics file lacks {path}")
    try:
        return parse_number(text)
    except ValueError as broken:
        raise CalibrationError(f"the kinematics file: {path}: {broken}") from broken
