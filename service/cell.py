"""The composition root: a cell file becomes drivers, and drivers become the Cell that procedures are lent."""

import os
import sqlite3
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from calibration.kinematics import load_model
from drivers.interfaces import (
    DistanceGauge,
    JogsAxes,
    MasteringStore,
    Operator,
    Robot,
    ToolFrameStore,
    UserFrameStore,
)
from procedures.cell import Cell, GaugeSetup, MotionLimits
from service.config import CellConfig, GaugeEntry
from service.journal import Journal, StoreError
from service.lease import DEVICES, lease
from service.store import Store


@asynccontextmanager
async def open_cell(config: CellConfig, operator: Operator, robot: str | None = None) -> AsyncIterator[Cell]:
    """Connect to one robot of the cell and to the gauge that is hooked to it; disconnect at the end.

    A second connection can take a gauge or a program away from the first, in the middle of a run: so one at a
    time.

    Raises
    ------
    LeaseHeldError
        Another cellcal is connected to them.
    DeviceError
        A device cannot be reached, or is not the one that the file names.
    """
    entry = config.robot(robot)
    async with AsyncExitStack() as devices:
        holder = f"another cellcal (process {os.getpid()})"
        devices.enter_context(lease(leases(config), entry.serial, holder, DEVICES))
        arm: Any = await devices.enter_async_context(entry.open())
        gauge_entry = config.gauge_for(entry.name)
        gauge: DistanceGauge | None = None
        if gauge_entry is not None:
            gauge = await devices.enter_async_context(gauge_entry.device.open())
        yield _lend(config, entry, arm, operator, gauge, gauge_entry)


async def lend_record(cell: Cell, journal: Journal) -> Cell:
    """Return the cell with the latest mastering record of its very robot, as the journal has it."""
    serial = (await cell.robot.identify()).serial
    return replace(cell, record=Store(journal).mastering_record(serial))


def journal_path(config: CellConfig) -> Path:
    """Return where the cell's journal lives."""
    return config.cell.data_dir / "journal.db"


def leases(config: CellConfig) -> Path:
    """Return where it is kept who works on which robot."""
    return config.cell.data_dir / "leases"


def open_journal(config: CellConfig) -> Journal:
    """Open the cell's journal, or create it.

    Raises
    ------
    StoreError
        The folder that the cell file names cannot be used.
    """
    path = journal_path(config)
    remedy = "See that data_dir of the cell file is a folder that may be written, on a disk with room."
    try:
        return Journal.open(path)
    except (OSError, sqlite3.Error) as error:
        raise StoreError(
            f"the journal {path} cannot be opened: {error}", remedy=remedy, code="store.io"
        ) from error
    except StoreError as error:
        raise StoreError(error.message, remedy=error.remedy or remedy, code=error.code) from error


def _lend(
    config: CellConfig,
    entry: Any,
    arm: Robot,
    operator: Operator,
    gauge: DistanceGauge | None,
    at: GaugeEntry | None,
) -> Cell:
    can = arm.capabilities
    return Cell(
        name=config.cell.name,
        robot=arm,
        operator=operator,
        jogs=cast(JogsAxes, arm) if can.jogs_single_axes else None,
        mastering=cast(MasteringStore, arm) if can.writes_mastering else None,
        tool_frames=cast(ToolFrameStore, arm) if can.writes_tool_frame else None,
        user_frames=cast(UserFrameStore, arm) if can.writes_user_frame else None,
        gauge=gauge,
        gauge_setup=None if at is None else _setup(at),
        model=load_model(entry.model),
        limits=MotionLimits(speed_rad_s=entry.speed_limit_rad_s, settle_s=getattr(entry, "settle_s", 1.0)),
        config_sha256=config.sha256,
    )


def _setup(entry: GaugeEntry) -> GaugeSetup:
    setup = entry.setup
    return GaugeSetup(
        anchor_in_base_m=setup.anchor_in_base_m,
        hook_in_flange_m=setup.hook_in_flange_m,
        sigma_anchor_m=setup.anchor_sigma_mm * 1e-3,
        sigma_hook_m=setup.hook_sigma_mm * 1e-3,
    )
