"""One fake controller on one loopback address: its ports and its beat.

Imitates
    The network side of the control box.
Source
    README of this package; the maker's client interface page.
Modelled
    30001 and 30002 (state ten times a second), 30003 (programs), 30004 (RTDE), 29999 (dashboard); with PolyScope X
    the Robot API and no dashboard. Controller steps by absolute deadlines: at the base rate when a client asks
    for more than 125 Hz, else at 125 Hz.
Not modelled
    Modbus on 502, the URCap port 50002, SFTP.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from cellcal.fake_devices.keep_running import keep_running
from cellcal.fake_devices.universal_robots.controller import ArmPort, UrController
from cellcal.fake_devices.universal_robots.dashboard import DashboardConnection
from cellcal.fake_devices.universal_robots.identity import UrIdentity
from cellcal.fake_devices.universal_robots.ports import TcpPort
from cellcal.fake_devices.universal_robots.primary import PrimaryConnection, RobotState
from cellcal.fake_devices.universal_robots.robot_api import DEFAULT_PORT, RobotApi, RobotApiConnection
from cellcal.fake_devices.universal_robots.rtde_port import RtdeConnection, RtdeServer
from cellcal.fake_devices.universal_robots.script_port import ProgramLoader, ScriptConnection

PRIMARY, SECONDARY, SCRIPT, RTDE, DASHBOARD = 30001, 30002, 30003, 30004, 29999
_SLOW_HZ = 125
_STATE_PERIOD_S = 0.1
_LATEST_S = 0.25  # further behind than this, steps are left out


class UniversalRobotServer:
    """The handle of a fake controller: ``start``, ``close``, and its parts for the faults."""

    def __init__(
        self,
        arm: ArmPort,
        address: str,
        identity: UrIdentity,
        world_s: Callable[[], float],
        *,
        robot_api_port: int = DEFAULT_PORT,
    ) -> None:
        self.address = address
        self.controller = UrController(arm, identity)
        self.rtde = RtdeServer(self.controller)
        self.loader = ProgramLoader(self.controller)
        self._state = RobotState(self.controller, self.rtde.readings)
        self._world_s = world_s
        self.ports: dict[int, TcpPort] = {
            PRIMARY: TcpPort(address, PRIMARY, self._primary_connection),
            SECONDARY: TcpPort(address, SECONDARY, self._primary_connection),
            SCRIPT: TcpPort(address, SCRIPT, lambda port: ScriptConnection(port, self.loader)),
            RTDE: TcpPort(address, RTDE, lambda port: RtdeConnection(port, self.rtde)),
        }
        self.robot_api = RobotApi(self.controller)
        if identity.is_polyscope_x:
            self.ports[robot_api_port] = TcpPort(
                address, robot_api_port, lambda port: RobotApiConnection(port, self.robot_api)
            )
        else:
            self.ports[DASHBOARD] = TcpPort(
                address, DASHBOARD, lambda port: DashboardConnection(port, self.controller)
            )
        self._beat: asyncio.Task[None] | None = None
        self._state_due_s = 0.0
        self.cable_in = True
        self._ports_change = asyncio.Lock()

    def _primary_connection(self, port: TcpPort) -> PrimaryConnection:
        return PrimaryConnection(port, self.loader, self._state)

    async def start(self) -> None:
        """Open every port and begin to beat; raise OSError when the address is taken."""
        try:
            await self.open_ports()
        except OSError:
            await self.close()
            raise
        self._beat = keep_running("time of the control box", self._run_loop)

    async def open_ports(self) -> None:
        """Listen on every port that does not."""
        self.cable_in = True
        await self._follow_cable()

    async def _reopen_ports(self) -> None:
        """Open again after a fault was cleared; the address may not be free at once."""
        if not all(port.is_open for port in self.ports.values()):
            with suppress(OSError):
                await self.open_ports()

    async def close_ports(self) -> None:
        """Cut every connection and stop listening; the controller goes on."""
        self.cable_in = False
        await self._follow_cable()

    async def _follow_cable(self) -> None:
        """Open or close all ports as the cable now is; one at a time, since several causes may ask at once.

        The last change of the cable waits for the others and then takes effect.
        """
        async with self._ports_change:
            for port in self.ports.values():
                await (port.open() if self.cable_in else port.close())

    async def close(self) -> None:
        """Switch the control box off."""
        beat, self._beat = self._beat, None
        if beat is not None:
            async with self._ports_change:  # a beat that is opening a port would leave it behind
                beat.cancel()
            with suppress(asyncio.CancelledError):
                await beat
        await self.close_ports()

    async def _run_loop(self) -> None:
        loop = asyncio.get_running_loop()
        rate_hz = self.controller.identity.base_rate_hz
        origin_s, step = loop.time(), 0
        while True:
            target = step + self._step_stride(rate_hz)
            delay_s = origin_s + target / rate_hz - loop.time()
            if (
                delay_s < -_LATEST_S
            ):  # go on with a step in which all clients have their turn, as without the gap
                now = int((loop.time() - origin_s) * rate_hz)
                target = max(target, now - now % self.rtde.longest_turn)
            await asyncio.sleep(max(0.0, delay_s))
            self._run_step(target, step)
            if self.cable_in:
                await self._reopen_ports()
            step = target

    def _step_stride(self, rate_hz: int) -> int:
        return 1 if self.rtde.fastest_hz > _SLOW_HZ else max(1, rate_hz // _SLOW_HZ)

    def _run_step(self, step: int, previous: int) -> None:
        timestamp_s = step / self.controller.identity.base_rate_hz
        self.loader.start_due()
        self.controller.step(timestamp_s, self._world_s())
        self.rtde.publish_state(step, previous)
        if timestamp_s >= self._state_due_s:
            self._state_due_s = timestamp_s + _STATE_PERIOD_S
            self._tell_state()

    def _tell_state(self) -> None:
        listeners = [c for number in (PRIMARY, SECONDARY) for c in self.ports[number].connections]
        if listeners:
            package = self._state.state_package()
            for listener in listeners:
                listener.send(package)
