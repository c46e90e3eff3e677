"""Parameter sets in from identifications and makers' files, and out as descriptions and makers' files."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.standard_dh import standard_dh
from cellcal.calibration.arm.ur_factory import factory_model, table_of_hash
from cellcal.calibration.arm.urdf import bare_urdf
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.geometry import log_transform
from cellcal.calibration.message import make_message
from cellcal.service.engineering.parameters.calibrated_models import (
    CalibratedModel,
    calibrated_description,
    calibrated_model,
    nominal_sha256,
    values_of_identification,
    values_of_model,
)
from cellcal.service.engineering.parameters.identified_parameter import IdentifiedParameter
from cellcal.service.engineering.parameters.other_makers_files import other_file_error
from cellcal.service.engineering.parameters.parameter_set import (
    ParameterSet,
    ParameterSetError,
    ParameterValue,
    parse_set,
    to_text,
)
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.parameters.ur_files import (
    LINEARISED,
    RosKinematics,
    UrKinematics,
    model_of_ros,
    read_calibration_conf,
    read_primary_kinematics,
    read_ros_kinematics,
    ros_frames,
    write_calibration_conf,
    write_primary_kinematics,
    write_ros_kinematics,
)

_REST_WORTH_SAYING = 1e-9  # m and rad
_ROUNDED = 1e-8  # m and rad: files of arms as drawn hold ten digits


class FileKind(StrEnum):
    """File forms in which a calibrated arm is exported."""

    TOML = "toml"
    URDF = "urdf"
    CALIBRATION_CONF = "calibration-conf"
    PRIMARY = "primary"
    ROS_YAML = "ros-yaml"


@dataclass(frozen=True, slots=True)
class SetOrigin:
    """The robot of a set, and who says so."""

    robot_serial: str
    made_by: str
    made_at: str  # ISO 8601
    note: str = ""


@dataclass(frozen=True, slots=True)
class ImportedSet:
    """A saved set, and what a person should know about it."""

    parameter_set: ParameterSet
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DescriptionTemplate:
    """A description to be corrected, rather than a bare one written."""

    text: str
    tip_link: str
    base_link: str | None = None  # the description's root


@dataclass(frozen=True, slots=True)
class _FileContent:
    values: tuple[ParameterValue, ...]
    what: str
    factory_hash: str = ""
    notes: tuple[str, ...] = ()
    robot_serial: str = ""  # of the robot that the file names


def import_file(sets: ParameterSets, path: Path, nominal: RobotModel, who: SetOrigin) -> ImportedSet:
    """Save what a file says about an arm as the newest version.

    It may be the JSON of ``cellcal identify``, a parameter set, a UR controller's ``calibration.conf``, bytes
    of its primary interface, or the YAML of ``ur_calibration``.

    Raises
    ------
    CalibrationError
        The file is none of these, or of another robot; a YAML is of another arm than the controller's table.
    """
    data = read_plain_bytes(path)
    content = _read_content(data, nominal)
    factory_hash = _factory_hash(sets, who.robot_serial)
    if content.factory_hash and factory_hash and content.factory_hash != factory_hash:
        raise ParameterSetError(
            f"{path} belongs to another arm: it is {content.factory_hash}, robot {who.robot_serial} "
            f"is {factory_hash}.",
            remedy="Check the serial number; fetch the table from this controller again.",
        )
    digest = hashlib.sha256(data).hexdigest()
    draft = ParameterSet(
        robot_serial=who.robot_serial,
        model=nominal.name,
        nominal_sha256=nominal_sha256(nominal),
        made_at=who.made_at,
        made_by=who.made_by,
        source=make_message(
            "{what}: {file}, sha256 {sha256}", what=content.what, file=path.name, sha256=digest
        ),
        values=content.values,
        note=who.note,
        factory_hash=content.factory_hash or factory_hash,
    )
    calibrated_model(nominal, draft)
    return ImportedSet(sets.save_draft(draft), (*content.notes, *_serial_notes(content.robot_serial, who)))


def export_set(
    item: ParameterSet,
    nominal: RobotModel,
    kind: FileKind,
    *,
    template: DescriptionTemplate | None = None,
    geometric_joints: bool = False,
) -> tuple[bytes, tuple[str, ...]]:
    """Return the content of a file, and sentences about what it could not hold."""
    found = calibrated_model(nominal, item)
    notes = [f"a rigid arm cannot hold: {', '.join(found.left_out)}"] if found.left_out else []
    if kind is FileKind.TOML:
        return to_text(item).encode(), ()
    if kind is FileKind.URDF:
        text = _write_urdf(found, nominal, template, geometric_joints=geometric_joints)
        return text.encode(), tuple(notes)
    if not nominal.name.startswith("ur"):
        raise ParameterSetError(
            f"{kind} is a form of Universal Robots, {nominal.label} is none of theirs.",
            remedy="Export URDF.",
            code="usage",
        )
    written, more = _UR_WRITERS[kind](found.model, nominal, item.factory_hash)
    return written, (*notes, *more)


def _write_urdf(
    found: CalibratedModel,
    nominal: RobotModel,
    template: DescriptionTemplate | None,
    *,
    geometric_joints: bool,
) -> str:
    if template is None:
        return bare_urdf(found.model, geometric_joints=geometric_joints)
    return calibrated_description(
        template.text, template.tip_link, nominal, found.model, base_link=template.base_link
    )


def _factory_hash(sets: ParameterSets, robot_serial: str) -> str:
    if robot_serial not in sets.robot_serials():
        return ""
    return sets.load_set(robot_serial).factory_hash


def _read_content(data: bytes, nominal: RobotModel) -> _FileContent:
    if b"\0" in data:  # each length of a message begins with zeros, and no text holds one
        return _of_table(read_primary_kinematics(data), nominal, "primary interface")
    text = data.decode("utf-8-sig", errors="replace")
    start = text.lstrip()
    if start.startswith("{"):
        return _of_identification(text, nominal)
    if "delta_theta" in text:
        return _of_table(read_calibration_conf(text, nominal), nominal, "calibration.conf")
    if "[[parameter]]" in text:
        return _of_set(parse_set(text), nominal)
    if "kinematics:" in text:
        return _of_ros(read_ros_kinematics(text), nominal)
    raise other_file_error(text)


def _of_table(kinematics: UrKinematics, nominal: RobotModel, what: str) -> _FileContent:
    notes: tuple[str, ...] = ()
    if kinematics.status != LINEARISED:
        notes = (
            "the controller says that this table is not linearised: it may be nominal, or another arm's",
        )
    model = factory_model(nominal, kinematics.table)
    return _FileContent(values_of_model(nominal, model), what, kinematics.factory_hash, notes)


def _of_ros(ros: RosKinematics, nominal: RobotModel) -> _FileContent:
    model = model_of_ros(ros, nominal)
    is_nominal = np.allclose(model.placements, nominal.placements, rtol=0, atol=_ROUNDED)
    table = nominal.dh if is_nominal and nominal.dh is not None else standard_dh(model, nominal).table
    notes: tuple[str, ...] = ()
    if table_of_hash(table, ros.hash) is None:
        notes = (
            "its hash is not that of its numbers: they were rounded or changed since they were read from the "
            "controller; compare with its calibration.conf",
        )
    return _FileContent(values_of_model(nominal, model), "ur_calibration", ros.hash, notes)


def _of_set(item: ParameterSet, nominal: RobotModel) -> _FileContent:
    calibrated_model(nominal, item)
    return _FileContent(
        item.values,
        make_message(
            "parameter set {serial} version {version}", serial=item.robot_serial, version=item.version
        ),
        item.factory_hash,
        robot_serial=item.robot_serial,
    )


def _serial_notes(serial_in_file: str, who: SetOrigin) -> tuple[str, ...]:
    """Return the note that a file names another robot: no two arms have the same deviations."""
    if serial_in_file in ("", who.robot_serial):
        return ()
    return (
        make_message(
            "the file is of robot {serial_in_file}, and is kept as robot {serial}: right only where both are one arm",
            serial_in_file=serial_in_file,
            serial=who.robot_serial,
        ),
    )


def _of_identification(text: str, nominal: RobotModel) -> _FileContent:
    try:
        document = parse_json(text)
        robot = document["robot"]
        found = [_read_parameter(each) for each in document["parameters"]]
    except (ValueError, KeyError, TypeError) as broken:
        raise ParameterSetError(
            "this JSON is not a result of an identification.",
            remedy="Write it with `cellcal identify --json`.",
        ) from broken
    if robot != nominal.name:
        raise ParameterSetError(f"the identification is of a {robot}, not of a {nominal.label}.")
    values = values_of_identification(p for p in found if not p.name.startswith("wire "))
    return _FileContent(values, "identification")


def _read_parameter(entry: dict[str, Any]) -> IdentifiedParameter:
    found = IdentifiedParameter(**entry)
    words, numbers = (found.name, found.unit), (found.value, found.sigma, found.prior)
    right = all(isinstance(word, str) for word in words) and isinstance(found.held, bool)
    if not right or not all(type(number) in (int, float) for number in numbers):
        raise TypeError("a parameter is of a wrong kind")
    return found


def _write_conf(model: RobotModel, nominal: RobotModel, factory_hash: str) -> tuple[bytes, tuple[str, ...]]:
    kinematics, notes = _controller_table(model, nominal, factory_hash)
    return write_calibration_conf(kinematics, nominal).encode(), notes


def _write_primary(
    model: RobotModel, nominal: RobotModel, factory_hash: str
) -> tuple[bytes, tuple[str, ...]]:
    kinematics, notes = _controller_table(model, nominal, factory_hash)
    return write_primary_kinematics(kinematics), notes


def _controller_table(
    model: RobotModel, nominal: RobotModel, factory_hash: str
) -> tuple[UrKinematics, tuple[str, ...]]:
    """Return the table as its controller writes it, where the hash tells that, and what it cannot hold."""
    found = standard_dh(model, nominal)
    own_table = table_of_hash(found.table, factory_hash) if factory_hash else None
    return UrKinematics(own_table or found.table), _flange_notes(log_transform(found.flange_rest))


def _write_ros(model: RobotModel, nominal: RobotModel, factory_hash: str) -> tuple[bytes, tuple[str, ...]]:
    if not factory_hash:
        raise ParameterSetError(
            "the hash by which ROS names this arm is unknown.",
            remedy="Import the controller's calibration.conf first: the hash of its table is that name.",
        )
    text = write_ros_kinematics(RosKinematics(ros_frames(model), factory_hash))
    back = model_of_ros(read_ros_kinematics(text), nominal)
    still = np.zeros((1, nominal.axis_count))
    rest = log_transform(np.linalg.inv(back.base_flange(still)[0]) @ model.base_flange(still)[0])
    return text.encode(), _flange_notes(rest)


def _flange_notes(rest: np.ndarray) -> tuple[str, ...]:
    if np.abs(rest).max() < _REST_WORTH_SAYING:
        return ()
    shift, turn = rest[:3] * 1e3, np.rad2deg(rest[3:])
    return (
        "such a file cannot hold how the flange sits on the last axis; put it into the tool: "
        f"x y z {', '.join(f'{v:.4f}' for v in shift)} mm, "
        f"rotation vector {', '.join(f'{v:.5f}' for v in turn)} deg",
    )


_UR_WRITERS: dict[FileKind, Callable[[RobotModel, RobotModel, str], tuple[bytes, tuple[str, ...]]]] = {
    FileKind.CALIBRATION_CONF: _write_conf,
    FileKind.PRIMARY: _write_primary,
    FileKind.ROS_YAML: _write_ros,
}
