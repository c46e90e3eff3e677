"""Reach every device of a cell and say what is missing, before work begins."""

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cellcal.calibration.arm.kinematics import MODEL_TOLERANCE_M, load_model
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import DeviceError, RefusedError
from cellcal.drivers.interfaces import ComparesJoints, Device, DoubtsIdentity, JointReading, Readiness, Robot
from cellcal.drivers.registry import RobotConfig
from cellcal.drivers.wire.evidence import AbilityEvidence, driver_evidence
from cellcal.procedures.steps.mastering import model_error_m
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import Journal, JournalDamage
from cellcal.service.record.journal_end import missing_end
from cellcal.service.record.journal_files import lease_folder, open_journal
from cellcal.service.record.robot_lock import DEVICES, is_held
from cellcal.service.record.run_store import RunStore

IN_USE = "in use"
_STANDS = (
    Readiness.NOT_READY,
    Readiness.STOPPED,
)  # in manual mode, or stopped: its joints are to be believed
OTHER_MODEL = "another model"
_NOT_COMPARED = (
    "Its controller shows no flange pose, so the joints were not compared with the model of the cell file."
)
_FIRST_SCREEN = (
    "No mastering record of {robot} is stored. Take it now, while the robot is healthy: "
    "`cellcal run mastering_record --cell {path}`. Without it a lost turn cannot be restored exactly."
)


@dataclass(frozen=True, slots=True)
class ShownJoint:
    """Where an axis stands, as its pendant shows it."""

    name: str
    value: float
    unit: str  # deg, or mm of an axis that slides


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """The report of one device."""

    name: str
    state: str
    message: str
    remedy: str = ""
    serial: str = ""
    keeps_mastering: bool = False
    evidence: tuple[AbilityEvidence, ...] = ()  # of a robot's abilities
    joints: tuple[
        ShownJoint, ...
    ] = ()  # to be compared with the pendant; none of a robot that lost its position

    @property
    def is_ready(self) -> bool:
        """Whether a procedure could use it now."""
        return self.state == Readiness.READY


@dataclass(frozen=True, slots=True)
class CellCheckReport:
    """A whole cell. ``damage`` tells where the journal stops being trustworthy."""

    cell: str
    devices: tuple[DeviceReport, ...]
    advice: tuple[str, ...]
    damage: str = ""

    @property
    def all_reached(self) -> bool:
        """Whether every device answered as the one that the file names."""
        return all(device.state not in (Readiness.UNREACHABLE, OTHER_MODEL) for device in self.devices)

    @property
    def in_use(self) -> bool:
        """Whether a device was skipped because it is in use."""
        return any(device.state == IN_USE for device in self.devices)

    def as_object(self) -> dict[str, object]:
        """Return the report for ``--json``."""
        return {**asdict(self), "all_reached": self.all_reached}


async def check_cell(config: CellConfig) -> CellCheckReport:
    """Reach all devices at once; an unreachable one is a line of the report, not an end."""
    folder = lease_folder(config)
    pairs: list[tuple[Any, str]] = [
        (entry.device, config.robot_named(entry.setup.robot).serial) for entry in config.gauges
    ]
    pairs += [(entry.device, config.robot_named(entry.setup.robot).serial) for entry in config.trackers]
    pairs += [(entry.device, config.robot_named(entry.setup.robot).serial) for entry in config.probes]
    devices = await asyncio.gather(
        *(_check_device(robot, robot.serial, folder, _report_robot) for robot in config.robots),
        *(_check_device(*pair, folder, _report_device) for pair in pairs),
    )
    evidence = {robot.name: driver_evidence(_brand_of(robot), _profile_of(robot)) for robot in config.robots}
    devices = [replace(device, evidence=evidence.get(device.name, ())) for device in devices]
    with open_journal(config) as journal:
        damage = journal_flaw(config, journal)
        if damage:
            return CellCheckReport(config.cell.name, tuple(devices), (), damage)
        store = RunStore(journal)
        advice = tuple(
            _FIRST_SCREEN.format(robot=device.name, path=config.path)
            for device in devices
            if device.keeps_mastering and store.mastering_record(device.serial) is None
        )
    return CellCheckReport(config.cell.name, tuple(devices), advice)


def _brand_of(robot: object) -> str:
    """Return the package of drivers that a robot's entry belongs to."""
    return type(robot).__module__.split(".")[2]  # cellcal.drivers.<brand>


def _profile_of(robot: Any) -> str:
    """Return which of several kinds of controller a driver talks to."""
    return str(getattr(robot, "profile", robot.driver))


def journal_flaw(config: CellConfig, journal: Journal) -> str:
    """Return in words that a journal is damaged or lacks its end; "" where it is whole, as far as can be told."""
    damage = journal.verify_chain()
    return missing_end(config, journal) if damage is None else describe_damage(damage)


def describe_damage(damage: JournalDamage) -> str:
    """Return in words what is wrong with a journal, and what to do."""
    return make_message(
        "The journal is damaged after event {after_seq}: {reason}. Nothing is written to it any more. "
        "Restore a backup of data_dir.",
        after_seq=damage.after_seq,
        reason=damage.reason,
    )


async def _check_device(
    config: Any, robot: str, directory: Path, report_on: Callable[[Any, Any], Awaitable[DeviceReport]]
) -> DeviceReport:
    if is_held(directory, robot, DEVICES):
        return DeviceReport(
            config.name,
            IN_USE,
            "Another cellcal works with it now; it was left alone.",
            "Wait until that has ended.",
        )
    try:
        async with config.open() as device:
            return await report_on(device, config)
    except DeviceError as error:
        return DeviceReport(config.name, Readiness.UNREACHABLE, error.message, error.remedy)


async def _report_robot(device: Robot, config: RobotConfig) -> DeviceReport:
    report = await _report_device(device, config)
    report = replace(report, keeps_mastering=device.capabilities.writes_mastering)
    report = await _compare_joint_sources(device, report)
    if not device.capabilities.tells_flange_pose:
        report = replace(report, message=f"{report.message} {_NOT_COMPARED}")
    if report.is_ready:
        try:
            return await _look_at_joints(device, config.model, report)
        except RefusedError as error:
            return _as_not_ready(report, error)
    if report.state in _STANDS:
        with suppress(DeviceError):  # what such a robot does not show now is compared when it is ready
            return await _look_at_joints(device, config.model, report)
    return report


async def _look_at_joints(device: Robot, name: str, report: DeviceReport) -> DeviceReport:
    """Report where the axes stand and, where the controller shows its flange, compare that with the model."""
    joints = await device.read_joints()
    sliding = load_model(name).sliding
    slides = [False] * len(joints.joints_rad) if sliding is None else [bool(each) for each in sliding]
    shown = (
        ShownJoint(
            device.capabilities.axis_name(axis),
            value * 1e3 if slides[axis] else math.degrees(value),
            "mm" if slides[axis] else "deg",
        )
        for axis, value in enumerate(joints.joints_rad)
    )
    report = replace(report, joints=tuple(shown))
    if not device.capabilities.tells_flange_pose:
        return report
    try:
        return await _hold_against_model(device, name, joints, report)
    except RefusedError as error:  # it shows its axes, and something is selected that has to be changed first
        return _as_not_ready(report, error) if report.is_ready else report


async def _compare_joint_sources(device: Robot, report: DeviceReport) -> DeviceReport:
    """Say what comes over a second link, where the cell file names one; joints that differ make a robot not ready."""
    if not isinstance(device, ComparesJoints):
        return report
    try:
        found = await device.joint_sources()
    except DeviceError as error:
        return _as_not_ready(report, error)
    return replace(report, message=join_messages(" ", (report.message, found))) if found else report


def _as_not_ready(report: DeviceReport, error: DeviceError) -> DeviceReport:
    """Return the report of a robot that is reached, and refuses or contradicts a look."""
    message = join_messages(" ", (report.message, error.message))
    return replace(report, state=Readiness.NOT_READY, message=message, remedy=error.remedy)


async def _hold_against_model(
    device: Robot, name: str, joints: JointReading, report: DeviceReport
) -> DeviceReport:
    """Compare where the controller sees its flange with where the file's model puts it."""
    error_m = model_error_m(load_model(name), joints.joints_rad, await device.flange_pose())
    if joints.moving or error_m <= MODEL_TOLERANCE_M:
        return report
    return replace(
        report,
        state=OTHER_MODEL,
        message=make_message(
            "{report_message} Its flange is {error_mm:.0f} mm from where a {name} has it.",
            report_message=report.message,
            error_mm=error_m * 1000.0,
            name=name,
        ),
        remedy="Correct the robot's model in the cell file.",
    )


async def _report_device(device: Device | Robot, config: Any) -> DeviceReport:
    del config
    identity = await device.identify()
    condition = await device.read_condition()
    who = f"{identity.vendor} {identity.model}, serial {identity.serial}, {identity.firmware}"
    doubts = await device.identity_doubts() if isinstance(device, DoubtsIdentity) else ""
    return DeviceReport(
        name=device.name,
        state=condition.readiness,
        message=" ".join(part for part in (f"{who}.", doubts, condition.message) if part),
        remedy=condition.remedy,
        serial=identity.serial,
    )
