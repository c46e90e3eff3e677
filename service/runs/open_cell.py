"""The composition root: a cell file becomes drivers, and drivers become the Cell that procedures use."""

import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any, cast

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import (
    DistanceGauge,
    GaugeCapabilities,
    JogsAxes,
    KnowsActiveFrames,
    KnowsMode,
    KnowsSpeedOverride,
    MasteringStore,
    Operator,
    ReadsMastering,
    Robot,
    TellsPositionData,
    ToolFrameStore,
    UserFrameStore,
)
from cellcal.procedures.cell import Cell, DeviceCertificate, GaugeSetup, MotionCaps, ProbeSetup, TrackerSetup
from cellcal.procedures.recovery.pendant_mastering import PendantMastering
from cellcal.procedures.shown_motors import ShownMotors
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.configuration.instrument_tables import GaugeEntry, ProbeEntry, TrackerEntry
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import lease_folder
from cellcal.service.record.robot_lock import DEVICES, acquire_lease
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.pendant_programs import program_shelf


@asynccontextmanager
async def open_cell(config: CellConfig, operator: Operator, robot: str | None = None) -> AsyncIterator[Cell]:
    """Connect to one robot of the cell, its gauge, its tracker and its probes; disconnect at the end.

    A second connection can take a gauge or a program away from the first, in the middle of a run: so one at a
    time.

    Raises
    ------
    LeaseHeldError
        Another cellcal is connected to them.
    DeviceError
        A device cannot be reached, or is not the one that the file names.
    """
    entry = config.robot_named(robot)
    async with AsyncExitStack() as devices:
        holder = make_message("another cellcal (process {number})", number=os.getpid())
        devices.enter_context(acquire_lease(lease_folder(config), entry.serial, holder, DEVICES))
        arm: Any = await devices.enter_async_context(entry.open())
        gauge_entry = config.gauge_for(entry.name)
        gauge: DistanceGauge | None = None
        if gauge_entry is not None:
            gauge = await devices.enter_async_context(_open_device(gauge_entry.device, operator))
        cell = _build_cell(config, entry, arm, operator, gauge, gauge_entry)
        tracker_entry = config.tracker_for(entry.name)
        if tracker_entry is not None:
            tracker = await devices.enter_async_context(_open_device(tracker_entry.device, operator))
            cell = replace(cell, tracker=tracker, tracker_setup=_tracker_setup(tracker_entry))
        for probe_entry in config.probes_for(entry.name):
            probe = await devices.enter_async_context(_open_device(probe_entry.device, operator))
            cell = _with_probe(cell, probe, probe_entry)
        yield cell


@dataclass(frozen=True, slots=True)
class DeclaredDevice:
    """A device as declared in the cell file. It answers nothing: there is no connection."""

    name: str
    capabilities: Any = None


def offline_cell(config: CellConfig, robot: str | None = None) -> Cell:
    """Return the cell as its file describes it, without reaching a device: to plan with, never to run."""
    entry = config.robot_named(robot)
    arm: Any = DeclaredDevice(entry.name, entry.capabilities)
    gauge_entry, tracker_entry = config.gauge_for(entry.name), config.tracker_for(entry.name)
    no_operator: Any = None
    cell = _build_cell(config, entry, arm, no_operator, _declared_gauge(gauge_entry), gauge_entry)
    if tracker_entry is not None:
        device = tracker_entry.device
        tracker: Any = DeclaredDevice(device.name, device.capabilities)
        cell = replace(cell, tracker=tracker, tracker_setup=_tracker_setup(tracker_entry))
    for probe_entry in config.probes_for(entry.name):
        cell = _with_probe(cell, DeclaredDevice(probe_entry.device.name), probe_entry)
    return cell


def _declared_gauge(entry: GaugeEntry | None) -> Any:
    if entry is None:
        return None
    device = entry.device
    return DeclaredDevice(device.name, GaugeCapabilities(device.range_m, 0.0, device.sigma_m))


async def with_robot_history(cell: Cell, journal: Journal) -> Cell:
    """Return the cell with what the journal holds of its very robot, and all alignments."""
    return RunStore(journal).with_history(cell, (await cell.robot.identify()).serial)


def _open_device(device: Any, operator: Operator) -> Any:
    """Open a device; one without a wire asks the operator."""
    return device.open(operator) if device.driver == "file_import" else device.open()


def _build_cell(
    config: CellConfig,
    entry: Any,
    arm: Robot,
    operator: Operator,
    gauge: DistanceGauge | None,
    at: GaugeEntry | None,
) -> Cell:
    can, motion = arm.capabilities, config.motion_of(entry.name)
    return Cell(
        name=config.cell.name,
        robot=arm,
        operator=operator,
        jogs=cast(JogsAxes, arm) if can.jogs_single_axes else None,
        mastering=_mastering_store(arm, operator),
        position_data=cast(TellsPositionData, arm) if can.position_cure is not None else None,
        shown_motors=_shown_motors(arm, entry),
        tool_frames=cast(ToolFrameStore, arm) if can.writes_tool_frame else None,
        user_frames=cast(UserFrameStore, arm) if can.writes_user_frame else None,
        frames=cast(KnowsActiveFrames, arm) if can.tells_active_frames else None,
        mode=cast(KnowsMode, arm) if can.tells_mode else None,
        override=cast(KnowsSpeedOverride, arm) if can.tells_speed_override else None,
        named_frames=motion.active,
        gauge=gauge,
        gauge_setup=None if at is None else _gauge_setup(at),
        certificates=_instrument_certificates(config, entry.name),
        model=load_model(entry.model),
        limits=MotionCaps(speed_rad_s=entry.speed_limit_rad_s, settle_s=entry.settle_s),
        level=motion.level,
        surroundings=motion.surroundings,
        programs=program_shelf(config, entry),
        config_sha256=config.sha256,
    )


def _mastering_store(arm: Robot, operator: Operator) -> MasteringStore | None:
    """Return the robot's mastering: written by wire where its controller allows it, else typed by a person."""
    if arm.capabilities.writes_mastering:
        return cast(MasteringStore, arm)
    if arm.capabilities.reads_mastering:
        return PendantMastering(cast(ReadsMastering, arm), operator)
    return None


def _shown_motors(arm: Robot, entry: Any) -> ShownMotors | None:
    """Return the motors that shown joints tell, where mastering is pendant work and the gears are known."""
    if arm.capabilities.position_cure is None or entry.motor_turns_per_joint_turn is None:
        return None
    return ShownMotors(arm, entry.motor_turns_per_joint_turn)


def _instrument_certificates(config: CellConfig, robot: str) -> dict[str, DeviceCertificate]:
    named = ((role, entry.setup.certificate) for role, entry in config.instruments_for(robot).items())
    return {
        role: DeviceCertificate(
            certificate.number, certificate.issued.isoformat(), certificate.due.isoformat()
        )
        for role, certificate in named
        if certificate is not None
    }


def _gauge_setup(entry: GaugeEntry) -> GaugeSetup:
    setup = entry.setup
    return GaugeSetup(
        anchor_in_base_m=setup.anchor_in_base_m,
        hook_in_flange_m=setup.hook_in_flange_m,
        sigma_anchor_m=setup.anchor_sigma_mm * 1e-3,
        sigma_hook_m=setup.hook_sigma_mm * 1e-3,
        mouth_at_m=None if setup.mouth_at_mm is None else _to_metres(setup.mouth_at_mm),
    )


def _to_metres(millimetres: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = millimetres
    return (x * 1e-3, y * 1e-3, z * 1e-3)


def _tracker_setup(entry: TrackerEntry) -> TrackerSetup:
    setup = entry.setup
    return TrackerSetup(setup.target_in_flange_m, setup.target_sigma_mm * 1e-3)


def _with_probe(cell: Cell, probe: Any, entry: ProbeEntry) -> Cell:
    x, y, z = entry.setup.tip_in_flange_mm
    tip_in_flange_m = (x * 1e-3, y * 1e-3, z * 1e-3)
    setup = ProbeSetup(tip_in_flange_m, entry.setup.tip_sigma_mm * 1e-3, entry.setup.axis_in_flange)
    if entry.role == "probe":
        return replace(cell, probe=probe, probe_setup=setup)
    return replace(cell, dial=probe, dial_setup=setup)
