"""The reading side of one robot: its state stream and its name plate, found again when the link was lost.

A lost stream is connected anew by the next call that needs it, and the name plate is checked each time:
another robot may answer at the same address.
"""

import asyncio
import logging
import time
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import UnreachableError, WrongDeviceError
from cellcal.drivers.interfaces import Identity
from cellcal.drivers.universal_robots.arm_types import (
    ControllerKind,
    ReportedArm,
    check_arm,
    controller_kind,
    list_alternatives,
)
from cellcal.drivers.universal_robots.dashboard import UrDashboard
from cellcal.drivers.universal_robots.factory_calibration import ControllerArm, read_controller_arm
from cellcal.drivers.universal_robots.state import ControllerVersion, StateClient, StateSample
from cellcal.drivers.wire.serial_number import describe_untold_serial

if TYPE_CHECKING:
    from cellcal.drivers.universal_robots.robot_api import RobotApiClient

_log = logging.getLogger(__name__)

VENDOR = "Universal Robots"
VERIFIED_ON: tuple[str, ...] = ()  # controller software tried with a real arm; none so far, see README.md


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """The period of the controller's reports, and the time to wait for one."""

    rate_hz: float
    stale_s: float
    deadline_s: float


@dataclass(frozen=True, slots=True)
class ExpectedRobot:
    """The robot of the cell file. ``calibration``: the name of its factory table, "" where none is given."""

    arm: str
    serial: str
    calibration: str = ""


class RobotConnection:
    """One robot that answers at an address, proved to be the one of the cell file as far as its controller tells."""

    def __init__(
        self,
        device: str,
        address: str,
        expected: ExpectedRobot,
        timing: StreamTiming,
        *,
        robot_api_port: int = 80,
    ) -> None:
        self.device, self._address, self._timing = device, address, timing
        self._expected = expected
        self._part_s = timing.deadline_s / 4
        self._dashboard = UrDashboard(device, address, deadline_s=self._part_s)
        self._robot_api_port = robot_api_port
        self._kind = ControllerKind.POLYSCOPE_5  # until it has told its software
        self._state: StateClient | None = None
        self._identity: Identity | None = None
        self._doubts = ""
        self._remote: tuple[float, bool] = (float("-inf"), False)
        self._operational: tuple[float, str] = (float("-inf"), "")
        self._connecting = asyncio.Lock()
        self._closed = False

    @cached_property
    def _robot_api(self) -> "RobotApiClient":
        from cellcal.drivers.universal_robots.robot_api import RobotApiClient  # noqa: PLC0415  for PolyScope X alone

        return RobotApiClient(self.device, self._address, self._robot_api_port, deadline_s=self._part_s)

    @property
    def is_connected(self) -> bool:
        """Whether the state stream is connected, as known without waiting."""
        return self._state is not None and self._state.is_alive

    async def ensure_stream(self) -> StateClient:
        """Return the state stream, connected; connect it when it is not.

        A loss that was not yet reported is raised once: the arm may have been moved in between.
        """
        async with self._connecting:
            if self._closed:
                raise UnreachableError(self.device, "the connection has been closed by us.")
            lost = self._state
            if lost is not None and not lost.is_alive:
                self._state = None
                lost.report_loss()
            if self._state is None:
                self._state = await self._connect_state()
            return self._state

    async def read_sample(self) -> StateSample:
        """Return a state that was sent after this call."""
        return await (await self.ensure_stream()).read_fresh()

    async def read_identity(self) -> Identity:
        """Return the name plate that was read when the stream was connected."""
        await self.ensure_stream()
        if self._identity is None:
            raise UnreachableError(self.device, "the robot has not told who it is.")
        return self._identity

    async def read_doubts(self) -> str:
        """Return in sentences what the name plate does not prove; "" where it proves all."""
        await self.read_identity()
        return self._doubts

    @property
    def tells_remote_control(self) -> bool:
        """Whether this controller says who has control; the first Robot API does not."""
        return self._kind is not ControllerKind.POLYSCOPE_X or self._robot_api.tells_modes

    async def in_remote_control(self, *, known_s: float = 0.0) -> bool:
        """Whether the pendant is in Remote; an answer not older than ``known_s`` will do."""
        asked_s, remote = self._remote
        if time.monotonic() - asked_s > known_s:
            on_x = self._kind is ControllerKind.POLYSCOPE_X
            remote = await (self._robot_api if on_x else self._dashboard).in_remote_control()
            self._remote = (time.monotonic(), remote)
        return remote

    async def operational_mode(self, *, known_s: float = 0.0) -> str:
        """Return the operational mode where the controller tells it, else ""; ``known_s`` as for the control."""
        if self._kind is not ControllerKind.POLYSCOPE_X:
            return ""
        asked_s, mode = self._operational
        if time.monotonic() - asked_s > known_s:
            mode = await self._robot_api.operational_mode()
            self._operational = (time.monotonic(), mode)
        return mode

    async def stop_program(self) -> None:
        """Stop whatever program runs, on a path of its own; the arm decelerates and stays where it is."""
        on_x = self._kind is ControllerKind.POLYSCOPE_X
        await (self._robot_api if on_x else self._dashboard).stop_program()

    async def close(self) -> None:
        """Hang up for good."""
        self._closed = True
        if self._state is not None:
            self._state.close()
        if "_robot_api" in self.__dict__:
            await self._robot_api.close()

    async def _connect_state(self) -> StateClient:
        timing = self._timing
        state = StateClient(self.device, self._address, rate_hz=timing.rate_hz, stale_s=timing.stale_s)
        version = await state.connect(deadline_s=timing.deadline_s / 2)
        try:
            self._kind = controller_kind(self.device, version)
            self._identity = await self._read_name_plate(version)
        except BaseException:
            state.close()
            raise
        return state

    async def _read_name_plate(self, version: ControllerVersion) -> Identity:
        arm = await read_controller_arm(self.device, self._address, deadline_s=self._part_s)
        on_x = self._kind is ControllerKind.POLYSCOPE_X
        serial, name = await self._ask_robot_api() if on_x else await self._ask_dashboard()
        reported = ReportedArm(version, arm.type_code, name)
        others = check_arm(self.device, self._address, self._expected.arm, reported)
        self._check_serial(serial)
        self._check_calibration(arm)
        self._doubts = self._describe_doubts(arm, others, tells_serial=serial is not None)
        if self._identity is None and not str(version).startswith(VERIFIED_ON):
            _log.warning("%s: not verified on controller software %s", self.device, version)
        return Identity(VENDOR, self._expected.arm, self._expected.serial, str(version))

    async def _ask_dashboard(self) -> tuple[str | None, str | None]:
        return await self._dashboard.serial_number(), await self._dashboard.read_model()

    async def _ask_robot_api(self) -> tuple[str | None, str | None]:
        await self._robot_api.connect()
        return await self._robot_api.name_plate()

    def _check_serial(self, serial: str | None) -> None:
        if serial is None or serial == self._expected.serial:
            return
        raise WrongDeviceError(
            self.device,
            make_message(
                "at {address} answers the {model} with serial {found_serial}; the cell file names serial "
                "{expected_serial}.",
                address=self._address,
                model=self._expected.arm,
                found_serial=serial,
                expected_serial=self._expected.serial,
            ),
            remedy="Correct the address or the serial in the cell file.",
        )

    def _check_calibration(self, arm: ControllerArm) -> None:
        expected, found = self._expected.calibration, arm.factory.name
        if expected in ("", found):
            return
        raise WrongDeviceError(
            self.device,
            make_message(
                "at {address} answers an arm with the factory calibration {found}; the cell file names {expected}.",
                address=self._address,
                found=found,
                expected=expected,
            ),
            remedy="Correct the address, or the calibration in the cell file if the arm was exchanged.",
        )

    def _describe_doubts(self, arm: ControllerArm, others: tuple[str, ...], *, tells_serial: bool) -> str:
        found = []
        if others:
            found.append(
                make_message(
                    "Its controller does not tell a {model} from a {others}: compare the label on the arm.",
                    model=self._expected.arm,
                    others=list_alternatives(others),
                )
            )
        if not tells_serial and not arm.factory.is_measured:
            found.append(
                make_message(
                    "Its controller does not tell a serial number, and says that the factory calibration is not "
                    "linearised: nothing tells this arm from another {model}.",
                    model=self._expected.arm,
                )
            )
        elif not tells_serial and not self._expected.calibration:
            found += [
                describe_untold_serial(self._expected.serial),
                make_message(
                    'Write calibration = "{calibration}" into the entry of the robot: it is compared at every '
                    "connect.",
                    calibration=arm.factory.name,
                ),
            ]
        return join_messages(" ", found)
