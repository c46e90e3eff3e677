"""The reading side of one robot: its state stream and its name plate, found again when the link was lost.

A lost stream is connected anew by the next call that needs it, and the name plate is checked each time:
another robot may answer at the same address.
"""

import asyncio
import logging
import time
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, UnreachableError, WrongDeviceError
from cellcal.drivers.interfaces import Identity
from cellcal.drivers.universal_robots.dashboard import UrDashboard
from cellcal.drivers.universal_robots.state import ControllerVersion, StateClient, StateSample

_log = logging.getLogger(__name__)

VENDOR = "Universal Robots"
VERIFIED_ON: tuple[str, ...] = ()  # controller software tried with a real arm; none so far, see README.md
_OLDEST, _NEWEST_MAJOR = (5, 6), 5


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """How often the controller reports, and how long we wait."""

    rate_hz: float
    stale_s: float
    deadline_s: float


class RobotConnection:
    """One robot that answers at an address, proved to be the one of the cell file."""

    def __init__(self, device: str, address: str, expected: tuple[str, str], timing: StreamTiming) -> None:
        self.device, self._address, self._timing = device, address, timing
        self._model, self._serial = expected
        self.dashboard = UrDashboard(device, address, deadline_s=timing.deadline_s / 4)
        self._state: StateClient | None = None
        self._identity: Identity | None = None
        self._remote: tuple[float, bool] = (float("-inf"), False)
        self._connecting = asyncio.Lock()
        self._closed = False

    @property
    def is_connected(self) -> bool:
        """Whether the state stream is connected, as far as anybody knows without waiting."""
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

    async def in_remote_control(self, *, known_s: float = 0.0) -> bool:
        """Whether the pendant is in Remote; an answer not older than ``known_s`` will do."""
        asked_s, remote = self._remote
        if time.monotonic() - asked_s > known_s:
            remote = await self.dashboard.in_remote_control()
            self._remote = (time.monotonic(), remote)
        return remote

    def close(self) -> None:
        """Hang up for good."""
        self._closed = True
        if self._state is not None:
            self._state.close()

    async def _connect_state(self) -> StateClient:
        timing = self._timing
        state = StateClient(self.device, self._address, rate_hz=timing.rate_hz, stale_s=timing.stale_s)
        version = await state.connect(deadline_s=timing.deadline_s / 2)
        try:
            self._check_version(version)
            self._identity = await self._read_name_plate(version)
        except BaseException:
            state.close()
            raise
        return state

    async def _read_name_plate(self, version: ControllerVersion) -> Identity:
        serial = await self.dashboard.serial_number()
        family = await self.dashboard.read_model()
        model = family.lower().removesuffix("e") + "e"  # 5.x is e-Series; the dashboard leaves it out
        if (model, serial) != (self._model, self._serial):
            raise WrongDeviceError(
                self.device,
                make_message(
                    "at {address} answers a {found_model} with serial {found_serial}; the cell file names a "
                    "{expected_model} with serial {expected_serial}.",
                    address=self._address,
                    found_model=model,
                    found_serial=serial,
                    expected_model=self._model,
                    expected_serial=self._serial,
                ),
                remedy="Correct the address or the serial in the cell file.",
            )
        if self._identity is None and not str(version).startswith(VERIFIED_ON):
            _log.warning("%s: not verified on controller software %s", self.device, version)
        return Identity(VENDOR, model, serial, str(version))

    def _check_version(self, version: ControllerVersion) -> None:
        if (version.major, version.minor) < _OLDEST or version.major > _NEWEST_MAJOR:
            raise RefusedError(
                self.device,
                make_message(
                    "the controller runs software {version}; this driver knows 5.6 to 5.25.", version=version
                ),
                remedy="Use a controller with PolyScope 5.6 or later, not PolyScope X.",
                vendor_text=str(version),
            )
