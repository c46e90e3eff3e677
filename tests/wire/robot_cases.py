"""What the contract suites need to know of each robot driver: a new one is one entry here."""

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from cellcal.drivers.errors import MotionStoppedError
from cellcal.drivers.interfaces import Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.cell_tables import fanuc_table, robot_table, universal_robots_table, write_table
from tests.wire.driver_cases import Fault, Truth, open_retrying, until_ready, wait_until

_SOON = {"deadline_s": 2.0, "step_s": 0.5, "settle_s": 0.02}
_ABB = {"driver": "abb_web_services", "model": "abb_irb1600_6_12", **_SOON, "deadline_s": 3.0}
_STREAM = {
    "window_s": 0.4,
    "silent_s": 1.5,
    "late_s": 0.5,
}  # a test machine may be too busy for a window of 0.2

KUKA_TABLE = robot_table(
    name="kuka",
    driver="kuka_variables",
    model="kuka_kr10r1420",
    serial="864231",
    fastest_axis_deg_s=410.0,
    **_SOON,
) + write_table("robot.rsi", listen="{second_address}", port=49152, **_STREAM)
ABB_TABLE = robot_table(name="abb", port=8080, serial="1600-500123", **_ABB)
EGM_TABLE = write_table("robot.egm", listen="{second_address}", **_STREAM)


@dataclass(frozen=True)
class RobotCase:
    """One robot of the cell file, by the name it has there."""

    name: str
    table: str  # its entry in the cell file of the wire tests, with what its fake is besides
    home_rad: tuple[float, ...]
    away_rad: tuple[float, ...]  # far enough that a move at ``slow_rad_s`` can be interrupted
    slow_rad_s: float
    heal: Callable[[FakeCellClient, Any], Awaitable[None]]  # robot ready again, whatever a test did to it
    link_faults: tuple[Fault, ...]  # every way in which the cable can fail
    stop_fault: Fault  # the emergency stop is pressed
    slow_fault: Fault  # the speed is turned down to 15 %
    mode_fault: tuple[str, str, str]  # a switch, and what the controller calls its places before and after
    impatient: dict[str, Any]  # of its entry: little time beyond what a move needs
    # what another one would tell; None: this link does not tell who answers
    stranger: dict[str, Any] | None = field(default_factory=lambda: {"serial": "X-000000"})
    believed_joints: Callable[[Truth], list[float]] = lambda truth: truth["controller_joints_rad"]


@asynccontextmanager
async def open_at_home(case: RobotCase, cell: CellConfig, fake_client: FakeCellClient) -> AsyncIterator[Any]:
    """Open the robot of a case, healthy and at its home position."""
    async with open_retrying(cell.robot_named(case.name)) as robot:
        await case.heal(fake_client, robot)
        if robot.capabilities.moves_joints:
            await _move_home(robot, case)
        else:
            await fake_client.inject_fault("hand_moves", device=case.name, joints=list(case.home_rad))
        yield robot


async def _move_home(robot: Any, case: RobotCase) -> None:
    """Move home; where a busy machine misses a heartbeat, which stops the arm, move on."""

    async def is_home() -> bool:
        try:
            await robot.move_joints(case.home_rad, speed_rad_s=0.5)
        except MotionStoppedError:
            return False
        return True

    await wait_until(is_home)


async def _heal_modbus_robot(fake_client: FakeCellClient, robot: Any) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("release_emergency_stop", device="fanuc")
    await fake_client.inject_fault("auto_mode", device="fanuc")
    await fake_client.inject_fault("override", device="fanuc", percent=100)
    await fake_client.inject_fault("select", device="fanuc", tool=1, frame=0)
    await robot.reset_position_alarms()


async def _heal_universal_robot(fake_client: FakeCellClient, robot: Any) -> None:
    await fake_client.send_command("clear")
    name = robot.name
    await fake_client.inject_fault("unlock_protective_stop", device=name)
    await fake_client.inject_fault("release_emergency_stop", device=name)
    await fake_client.inject_fault("program_stop", device=name)
    await fake_client.inject_fault("speed_slider", device=name, fraction=1.0)
    await fake_client.inject_fault("tool_switched", device=name, tcp=[0.0] * 6, payload_kg=0.0)
    await until_ready(robot, Readiness.READY)


async def _heal_fanuc_rmi(fake_client: FakeCellClient, robot: Any) -> None:
    await fake_client.send_command("clear")
    for fault in ("clear_alarms", "pendant_off"):
        await fake_client.inject_fault(fault, device="rmi")
    await fake_client.inject_fault("override", device="rmi", percent=100)
    await fake_client.inject_fault("sequence_restarts", device="rmi", on=False)
    await fake_client.inject_fault("tool_switched", device="rmi", number=1)
    await robot.stop()


async def _heal_kuka(fake_client: FakeCellClient, robot: Any) -> None:
    await fake_client.send_command("clear")
    for fault in ("mend", "new_server"):
        await fake_client.inject_fault(fault, device="kuka")
    await fake_client.inject_fault("override", device="kuka", percent=100)
    await fake_client.inject_fault("tool_switched", device="kuka", number=1)
    await robot.stop()


def _heal_abb_named(name: str) -> Callable[[FakeCellClient, Any], Awaitable[None]]:
    async def heal(fake_client: FakeCellClient, robot: Any) -> None:
        await fake_client.send_command("clear")
        await fake_client.inject_fault("mend", device=name)
        await fake_client.inject_fault("override", device=name, percent=100)
        await fake_client.inject_fault("tool_switched", device=name, tool="tGripper")
        await robot.stop()

    return heal


async def _heal_yaskawa(fake_client: FakeCellClient, robot: Any) -> None:
    await fake_client.send_command("clear")
    for fault in (
        "confirm_positions",
        "release_hold",
        "remote_mode",
        "release_emergency_stop",
        "reset_alarm",
    ):
        await fake_client.inject_fault(fault, device="motoman")
    await fake_client.inject_fault("override", device="motoman", percent=100)
    await fake_client.inject_fault("tool_switched", device="motoman", number=1)
    await robot.stop()


async def _heal_opc_ua(fake_client: FakeCellClient, robot: Any) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("mend", device="any_maker")
    await until_ready(robot, Readiness.READY)


ROBOTS: dict[str, RobotCase] = {
    "modbus_robot": RobotCase(
        name="fanuc",
        table=fanuc_table(deadline_s=2.0, settle_s=0.04),
        home_rad=(-0.35, 0.17, -0.44, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.006,
        heal=_heal_modbus_robot,
        link_faults=(("silent", {}), ("reset", {}), ("refuse", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("t1_mode", "AUTO", "T1"),
        impatient={"motion_margin_s": 1.0},
    ),
    "universal_robots": RobotCase(
        name="ur",
        table=universal_robots_table(deadline_s=2.0),
        home_rad=(-1.57, -1.57, -1.57, -1.57, 1.57, 0.0),
        away_rad=(-0.77, -1.2, -1.9, -1.3, 1.3, 0.4),
        slow_rad_s=0.006,
        heal=_heal_universal_robot,
        link_faults=(("link_loss_rtde", {}), ("link_loss_all", {}), ("link_stall", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("speed_slider", {"fraction": 0.15}),
        mode_fault=("local_mode", "remote control", "local control"),
        impatient={},
    ),
    "universal_robots_x": RobotCase(
        name="ur_x",
        table=universal_robots_table(
            name="ur_x",
            address="{second_address}",  # the maker's ports are fixed
            robot_api_port=8089,
            serial="20235500043",
            deadline_s=2.0,
        )
        + write_table("fake.robots.ur_x", software="10.12.1.0"),
        home_rad=(-1.57, -1.57, -1.57, -1.57, 1.57, 0.0),
        away_rad=(-0.77, -1.2, -1.9, -1.3, 1.3, 0.4),
        slow_rad_s=0.006,
        heal=_heal_universal_robot,
        link_faults=(("link_loss_rtde", {}), ("link_loss_all", {}), ("link_stall", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("speed_slider", {"fraction": 0.15}),
        mode_fault=("local_mode", "remote control, automatic", "local control, automatic"),
        impatient={},
        stranger={"calibration": "X-000000"},
    ),
    "fanuc_rmi": RobotCase(
        name="rmi",
        table=robot_table(name="rmi", driver="fanuc_rmi", model="fanuc_m6ib", serial="F-230816", **_SOON),
        home_rad=(-0.35, 0.17, -0.44, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.02,
        heal=_heal_fanuc_rmi,
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("pendant_on", "TP off", "TP on"),
        impatient={"stuck_s": 1.0},
        stranger=None,
    ),
    "kuka_variables": RobotCase(
        name="kuka",
        table=KUKA_TABLE,
        home_rad=(-1.3, -1.2, 1.3, 0.26, 0.85, 0.35),
        away_rad=(1.3, -1.1, 1.4, 0.3, 0.9, 0.2),
        slow_rad_s=0.075,
        heal=_heal_kuka,
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("open_gate", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("t1_mode", "AUT", "T1"),
        impatient={"stuck_s": 1.0},
    ),
    "abb_web_services": RobotCase(
        name="abb",
        table=ABB_TABLE,
        home_rad=(-0.9, 0.17, 0.2, 0.26, 0.85, 0.35),
        away_rad=(0.9, 0.3, 0.3, 0.3, 0.9, 0.2),
        slow_rad_s=0.03,
        heal=_heal_abb_named("abb"),
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("manual_mode", "AUTO", "MANR"),
        impatient={"stuck_s": 1.0},
    ),
    "abb_web_services 2": RobotCase(
        name="abb_7",
        table=robot_table(name="abb_7", port=8443, serial="460-300278", **_ABB)
        + EGM_TABLE
        + write_table("fake.robots.abb_7", generation=2),
        home_rad=(-0.9, 0.17, 0.2, 0.26, 0.85, 0.35),
        away_rad=(0.9, 0.3, 0.3, 0.3, 0.9, 0.2),
        slow_rad_s=0.03,
        heal=_heal_abb_named("abb_7"),
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("manual_mode", "AUTO", "MANR"),
        impatient={"stuck_s": 1.0},
    ),
    "opc_ua": RobotCase(
        name="any_maker",
        table=robot_table(
            name="any_maker",
            driver="opc_ua",
            port=4840,
            model="fanuc_m6ib",
            motion="observe",
            serial="ER-230817",
            deadline_s=2.0,
            still_s=0.1,
            speed_limit_rad_s=None,
        ),
        home_rad=(-0.35, 0.17, -0.44, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.02,
        heal=_heal_opc_ua,
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("mode", "AUTOMATIC", "MANUAL_REDUCED_SPEED"),
        impatient={},
    ),
    "yaskawa": RobotCase(
        name="motoman",
        table=robot_table(
            name="motoman",
            driver="yaskawa",
            model="yaskawa_gp25",
            controller_type="1-06VX25-A0*",
            serial="Y-230815",
            pulses_per_degree=[1341.4, 1341.4, -1341.4, 1000.0, 1000.0, -622.2],
            fastest_axis_deg_s=885.0,
            **_SOON,
        ),
        home_rad=(-0.35, 0.17, -0.2, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.02,
        heal=_heal_yaskawa,
        link_faults=(("silent", {}), ("refuse", {}), ("cut", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        mode_fault=("teach_mode", "REMOTE", "TEACH"),
        impatient={"stuck_s": 1.0},
        stranger={"controller_type": "X-000000"},
    ),
}
