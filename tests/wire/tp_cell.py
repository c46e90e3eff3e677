"""A cell with one controller that obeys the listings CELLCAL and CELLCAL_BG, and its case for the contract."""

from typing import Any

from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.cell_tables import cell_head, fake_table, fanuc_table
from tests.wire.fake_devices_process import TIME_FACTOR
from tests.wire.robot_cases import RobotCase

_TABLE = fanuc_table(profile="fanuc_tp", deadline_s=2.0, settle_s=0.04)
TP_CELL = cell_head("listings") + _TABLE + fake_table(time_factor=TIME_FACTOR)


async def heal_tp_robot(fake_client: FakeCellClient, robot: Any) -> None:
    """Do what a technician does: release, AUTO, RESET, START."""
    del robot
    await fake_client.send_command("clear")
    await fake_client.inject_fault("release_emergency_stop")
    await fake_client.inject_fault("auto_mode")
    await fake_client.inject_fault("override", percent=100)
    await fake_client.inject_fault("select", tool=1, frame=0)
    await fake_client.inject_fault("press_reset")
    await fake_client.inject_fault("abort_program")
    await fake_client.inject_fault("start_program")


TP_CASE = RobotCase(
    name="fanuc",
    table=_TABLE,
    home_rad=(-2.2, 0.17, -0.44, 0.26, -1.05, 0.35),
    away_rad=(2.2, 0.3, -0.3, 0.3, -0.9, 0.2),
    slow_rad_s=0.03,  # a per cent of J1's speed limit
    heal=heal_tp_robot,
    link_faults=(("silent", {}), ("reset", {}), ("refuse", {})),
    stop_fault=("emergency_stop", {}),
    slow_fault=("override", {"percent": 15}),
    mode_fault=("t1_mode", "AUTO", "T1"),
    impatient={"motion_margin_s": 1.0},
)
