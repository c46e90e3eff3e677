"""What the contract suites need to know of each driver: a new one is an entry here and in the cell file."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from cellcal.drivers.errors import DeviceError, MotionStoppedError
from cellcal.drivers.interfaces import Condition, ContactEdge, Readiness
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from tests.machine_speed import stretched_s

Fault = tuple[str, dict[str, Any]]
Truth = dict[str, Any]


@dataclass(frozen=True)
class RobotCase:
    """One robot of the cell file, by the name it has there."""

    name: str
    home_rad: tuple[float, ...]
    away_rad: tuple[float, ...]  # far enough that a move at ``slow_rad_s`` can be interrupted
    slow_rad_s: float
    heal: Callable[[FakeCellClient, Any], Awaitable[None]]  # robot ready again, whatever a test did to it
    link_faults: tuple[Fault, ...]  # every way in which the cable can fail
    stop_fault: Fault  # the emergency stop is pressed
    slow_fault: Fault  # the speed is turned down to 15 %
    impatient: dict[str, Any]  # of its entry: little time beyond what a move needs
    # what another one would tell; None: this link does not tell who answers
    stranger: dict[str, Any] | None = field(default_factory=lambda: {"serial": "X-000000"})
    believed_joints: Callable[[Truth], list[float]] = lambda truth: truth["controller_joints_rad"]


@dataclass(frozen=True)
class GaugeCase:
    """One gauge of the cell file, by the name it has there."""

    name: str
    heal: Callable[[FakeCellClient], Awaitable[None]]
    link_faults: tuple[Fault, ...]
    true_length_m: Callable[[Truth], float] = lambda truth: truth["reading_m"]
    shelf: str = "gauges"  # of the cell file and of the control port's truth
    shift_m: float = 0.05  # a change within its range
    stranger: Any = None  # the serial of another one; None: the next number
    shown_serial: Callable[[Any], str] = lambda config: str(config.serial)


@dataclass(frozen=True)
class ProbeCase:
    """One touch probe of the cell file, by the name it has there."""

    name: str
    heal: Callable[[FakeCellClient], Awaitable[None]]
    link_faults: tuple[Fault, ...]
    stale_faults: tuple[Fault, ...]  # every way in which its inputs can stop telling
    stranger: Any


async def wait_until(holds: Callable[[], Awaitable[bool]]) -> None:
    """Ask again and again until it holds; the world is another process and cannot tell us."""
    async with asyncio.timeout(stretched_s(60.0)):
        while not await holds():
            await asyncio.sleep(0.01)


@asynccontextmanager
async def open_retrying(config: Any) -> AsyncIterator[Any]:
    """Open a device that may still be coming back from what an earlier test did to it."""
    async with AsyncExitStack() as stack:
        found: list[Any] = []

        async def is_there() -> bool:
            try:
                found.append(await stack.enter_async_context(config.open()))
            except DeviceError:
                return False
            return True

        await wait_until(is_there)
        yield found[0]


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


async def until_ready(device: Any, readiness: Readiness) -> Condition:
    """Wait for one readiness and return the condition that had it."""
    found: list[Condition] = []

    async def is_ready() -> bool:
        found.append(await device.read_condition())
        return found[-1].readiness is readiness

    await wait_until(is_ready)
    return found[-1]


async def until_open(probe: Any) -> None:
    """Wait until a probe's contact is open."""

    async def is_open() -> bool:
        return not (await probe.read_contact()).closed

    await wait_until(is_open)


async def watch_touch(
    probe: Any, case: ProbeCase, fake_client: FakeCellClient
) -> "asyncio.Task[ContactEdge]":
    """Wait for a touch in a task of its own; return once the probe has seen the contact open.

    The driver's second write of its echo tells: the first one came back in the image that the watch starts from.
    """

    async def write_count() -> int:
        return int((await fake_client.read_truth())["probes"][case.name]["output_writes"])

    before = await write_count()
    task = asyncio.create_task(probe.wait_for_touch())

    async def has_looked() -> bool:
        return task.done() or await write_count() >= before + 2

    await wait_until(has_looked)
    return task


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


async def _heal_draw_wire(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("node_off", device="wire")  # forgets every answer that is still under way
    await fake_client.inject_fault("node_on", device="wire")
    await fake_client.inject_fault("wire_restore", device="wire")
    await fake_client.inject_fault("emcy_clear", device="wire")


async def _heal_by_clearing(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")


async def _heal_modbus_draw_wire(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("wire_restore", device="wire_tcp")


async def _heal_dial(fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    await fake_client.inject_fault("push_in", device="dial", m=0.004)


_MODBUS_LINK: tuple[Fault, ...] = (("silent", {}), ("reset", {}), ("refuse", {}), ("cut", {"bytes": 5}))
_OTHER_MAC = "00:30:DE:0A:0B:0D"


ROBOTS: dict[str, RobotCase] = {
    "modbus_robot": RobotCase(
        name="fanuc",
        home_rad=(-0.35, 0.17, -0.44, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.006,
        heal=_heal_modbus_robot,
        link_faults=(("silent", {}), ("reset", {}), ("refuse", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={"motion_margin_s": 1.0},
    ),
    "universal_robots": RobotCase(
        name="ur",
        home_rad=(-1.57, -1.57, -1.57, -1.57, 1.57, 0.0),
        away_rad=(-0.77, -1.2, -1.9, -1.3, 1.3, 0.4),
        slow_rad_s=0.006,
        heal=_heal_universal_robot,
        link_faults=(("link_loss_rtde", {}), ("link_loss_all", {}), ("link_stall", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("speed_slider", {"fraction": 0.15}),
        impatient={},
    ),
    "universal_robots_x": RobotCase(
        name="ur_x",
        home_rad=(-1.57, -1.57, -1.57, -1.57, 1.57, 0.0),
        away_rad=(-0.77, -1.2, -1.9, -1.3, 1.3, 0.4),
        slow_rad_s=0.006,
        heal=_heal_universal_robot,
        link_faults=(("link_loss_rtde", {}), ("link_loss_all", {}), ("link_stall", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("speed_slider", {"fraction": 0.15}),
        impatient={},
        stranger={"calibration": "X-000000"},
    ),
    "fanuc_rmi": RobotCase(
        name="rmi",
        home_rad=(-0.35, 0.17, -0.44, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.02,
        heal=_heal_fanuc_rmi,
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={"stuck_s": 1.0},
        stranger=None,
    ),
    "kuka_variables": RobotCase(
        name="kuka",
        home_rad=(-1.3, -1.2, 1.3, 0.26, 0.85, 0.35),
        away_rad=(1.3, -1.1, 1.4, 0.3, 0.9, 0.2),
        slow_rad_s=0.075,
        heal=_heal_kuka,
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("open_gate", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={"stuck_s": 1.0},
    ),
    "abb_web_services": RobotCase(
        name="abb",
        home_rad=(-0.9, 0.17, 0.2, 0.26, 0.85, 0.35),
        away_rad=(0.9, 0.3, 0.3, 0.3, 0.9, 0.2),
        slow_rad_s=0.03,
        heal=_heal_abb_named("abb"),
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={"stuck_s": 1.0},
    ),
    "abb_web_services 2": RobotCase(
        name="abb_7",
        home_rad=(-0.9, 0.17, 0.2, 0.26, 0.85, 0.35),
        away_rad=(0.9, 0.3, 0.3, 0.3, 0.9, 0.2),
        slow_rad_s=0.03,
        heal=_heal_abb_named("abb_7"),
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={"stuck_s": 1.0},
    ),
    "opc_ua": RobotCase(
        name="any_maker",
        home_rad=(-0.35, 0.17, -0.44, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.02,
        heal=_heal_opc_ua,
        link_faults=(("silent", {}), ("refuse", {}), ("reset", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={},
    ),
    "yaskawa": RobotCase(
        name="motoman",
        home_rad=(-0.35, 0.17, -0.2, 0.26, -1.05, 0.35),
        away_rad=(0.45, 0.3, -0.3, 0.3, -0.9, 0.2),
        slow_rad_s=0.02,
        heal=_heal_yaskawa,
        link_faults=(("silent", {}), ("refuse", {}), ("cut", {})),
        stop_fault=("emergency_stop", {}),
        slow_fault=("override", {"percent": 15}),
        impatient={"stuck_s": 1.0},
        stranger={"controller_type": "X-000000"},
    ),
}

GAUGES: dict[str, GaugeCase] = {
    "draw_wire": GaugeCase(
        name="wire",
        heal=_heal_draw_wire,
        link_faults=(("daemon_stop", {}), ("daemon_hang", {}), ("sdo_silent", {}), ("node_off", {})),
    ),
    "draw_wire_modbus": GaugeCase(name="wire_tcp", heal=_heal_modbus_draw_wire, link_faults=_MODBUS_LINK),
    "dial_gauge": GaugeCase(
        name="dial",
        heal=_heal_dial,
        link_faults=_MODBUS_LINK,
        shelf="probes",
        shift_m=0.002,
        stranger=_OTHER_MAC,
        shown_serial=lambda config: config.serial.replace(":", "").lower(),
    ),
}

PROBES: dict[str, ProbeCase] = {
    "touch_probe": ProbeCase(
        name="probe",
        heal=_heal_by_clearing,
        link_faults=_MODBUS_LINK,
        stale_faults=(("image_frozen", {}), ("bus_break", {"terminal": 2}), ("watchdog_expired", {})),
        stranger=_OTHER_MAC,
    ),
}
