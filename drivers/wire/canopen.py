"""One CANopen node, fenced: python-can and canopen run in threads of their own and are watched.

What the two libraries leave to their caller, and what is done about it here and in ``can_session.py``:

* a node that falls silent is not noticed: its heartbeat has to come within 2.5 of its periods, or the bus is
  closed, and the next call opens it again
* a malformed line blocks python-can's buffer for ever: any receive error closes the bus
* a refused port is retried for 10 s in a busy loop: the daemon is greeted by us first, with a deadline; its
  other traps are closed in ``socketcand.py``
* canopen unpacks EMCY frames of eight bytes only: we take any length and latch it until the node says 0000h
* an SDO answer that comes after its time-out may meet the next request for the same object: the session ends,
  the node is left quiet for as long again, and an answer more than there were questions ends a session too
* configuration files of python-can are not looked at
"""

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable
from typing import TypeVar

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    RefusedError,
    UnreachableError,
    WireProtocolError,
)
from cellcal.drivers.wire.backoff import Backoff
from cellcal.drivers.wire.can_session import FOREIGN_S, BusOptions, CanSession, Emergency
from cellcal.drivers.wire.trace import FrameTrace
from cellcal.drivers.wire.worker import CallWorker

T = TypeVar("T")
ServerCheck = Callable[["CanopenLink"], Awaitable[None]]

_HEARTBEAT_TIME = 0x1017
_ANSWER_SHARE = 0.3  # of the deadline, for one SDO answer
_READ_ONLY = (0x06010002, 0x06010000)
_DAEMON = "Check that the CAN gateway is on, and host and port in cell.toml; then try again."


class CanopenLink:
    """Reads and writes objects of one node; reconnects by itself; one transfer at a time."""

    def __init__(
        self, device: str, options: BusOptions, node_id: int, *, deadline_s: float, heartbeat_s: float
    ) -> None:
        self.device = device
        self.trace = FrameTrace(device)
        self.check_server: ServerCheck | None = None
        self._options, self._id, self._heartbeat_s = options, node_id, heartbeat_s
        self._deadline_s = deadline_s
        self._session: CanSession | None = None
        self._worker: CallWorker | None = None
        self._emergency: Emergency | None = None
        self._turn = asyncio.Lock()
        self._backoff = Backoff()
        self._quiet_until_s = 0.0
        self._foreign_at_s = float("-inf")

    @property
    def emergency(self) -> Emergency | None:
        """The last EMCY that was not taken back, also across a reconnect."""
        if self._session is not None:
            if self._session.emergency is not None:
                return self._session.emergency
            if self._session.emergencies_cleared:
                return None
        return self._emergency

    def forget_emergency(self) -> None:
        """Drop the latch: for a greeting that has read an empty error register."""
        self._emergency = None
        if self._session is not None:
            self._session.emergency = None

    @property
    def has_foreign_master(self) -> bool:
        """Whether another master has commanded this node lately."""
        seen_s = self._foreign_at_s if self._session is None else self._session.foreign_at_s
        return time.monotonic() - max(seen_s, self._foreign_at_s) < FOREIGN_S

    async def open(self) -> None:
        """Open the bus, switch the node's heartbeat on and greet it."""
        async with self._turn:
            await self._ready_session()

    async def close(self) -> None:
        """Close the bus and end the threads. May be called twice."""
        session, self._session = self._session, None
        worker, self._worker = self._worker, None
        if worker is None:
            return
        if session is not None:
            self._remember_state(session)
            try:
                async with asyncio.timeout(self._deadline_s):
                    await worker.run_call(session.close)
            except TimeoutError:
                pass  # its threads are daemons and end with their socket
        worker.stop()

    async def read(self, index: int, subindex: int) -> bytes:
        """Read one object."""
        async with self._turn:
            return await self._run_transfer(
                await self._ready_session(), lambda s: s.upload_object(index, subindex)
            )

    async def write(self, index: int, subindex: int, data: bytes) -> None:
        """Write one object."""
        async with self._turn:
            await self._run_transfer(
                await self._ready_session(), lambda s: s.download_object(index, subindex, data)
            )

    async def read_during_check(self, index: int, subindex: int) -> bytes:
        """Read while the connection is being made; for greetings only."""
        if self._session is None:
            raise UnreachableError(self.device, "the CAN bus was closed.", remedy=_DAEMON)
        return await self._run_transfer(self._session, lambda s: s.upload_object(index, subindex))

    async def _ready_session(self) -> CanSession:
        if self._session is not None and not self._session.dead:
            return self._session
        await self.close()
        await self._backoff.wait()
        await asyncio.sleep(self._quiet_until_s - time.monotonic())
        try:
            session = await self._connect_session()
            await self._start_heartbeat(session)
            if self.check_server is not None:
                await self.check_server(self)
        except BaseException:
            self._backoff.note_failure()
            await self.close()
            raise
        self._backoff.note_success()
        return session

    async def _connect_session(self) -> CanSession:
        if self._options.interface == "socketcand":
            await self._probe_daemon()
        self._worker = CallWorker(f"can worker {self.device}")
        session = CanSession(self.device, self._id, self.trace, answer_s=_ANSWER_SHARE * self._deadline_s)
        self._session = session
        await self._run_transfer(session, lambda s: s.open(self._options))
        return session

    async def _probe_daemon(self) -> None:
        """Look whether a daemon is there at all: python-can would knock for 10 s."""
        host, port = self._options.host, self._options.port
        try:
            async with asyncio.timeout(self._deadline_s / 2):
                reader, writer = await asyncio.open_connection(host, port)
                try:
                    await reader.readuntil(b"< hi >")
                finally:
                    writer.close()
                    await writer.wait_closed()
        except TimeoutError:
            raise self._no_daemon(
                make_message("the CAN gateway at {host}:{port} does not answer.", host=host, port=port)
            ) from None
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError) as error:
            raise self._no_daemon(
                make_message("no CAN gateway at {host}:{port}.", host=host, port=port)
            ) from error

    def _no_daemon(self, message: str) -> DeviceError:
        return UnreachableError(self.device, message, remedy=_DAEMON)

    async def _start_heartbeat(self, session: CanSession) -> None:
        """Ask for our period; a node with a fixed one tells us its own."""
        period_ms = round(self._heartbeat_s * 1000)
        try:
            period = struct.pack("<H", period_ms)
            await self._run_transfer(session, lambda s: s.download_object(_HEARTBEAT_TIME, 0, period))
        except RefusedError as error:
            if error.vendor_code not in _READ_ONLY:
                raise
            found = await self._run_transfer(session, lambda s: s.upload_object(_HEARTBEAT_TIME, 0))
            period_ms = int.from_bytes(found[:2], "little")
            if period_ms == 0:
                raise RefusedError(
                    self.device,
                    "the device has no heartbeat and does not let us switch it on.",
                    remedy="Switch its heartbeat (object 1017h) on with the maker's tool.",
                ) from error
        session.watch_heartbeat(period_ms * 1e-3)

    async def _run_transfer(self, session: CanSession, call: Callable[[CanSession], T]) -> T:
        worker = self._worker
        if worker is None:
            raise UnreachableError(self.device, "the CAN bus was closed.", remedy=_DAEMON)
        try:
            async with asyncio.timeout(self._deadline_s):
                return await worker.run_call(lambda: call(session))
        except (DeviceTimeoutError, WireProtocolError):
            self._quiet_until_s = time.monotonic() + _ANSWER_SHARE * self._deadline_s
            raise
        except TimeoutError:
            self._abandon_worker(session, worker)
            message = make_message(
                "the CAN bus did not react within {deadline_s:g} s.", deadline_s=self._deadline_s
            )
            raise DeviceTimeoutError(self.device, message, remedy=_DAEMON) from None

    def _abandon_worker(self, session: CanSession, worker: CallWorker) -> None:
        """Leave a thread that hangs inside a library to itself; it ends when its socket does."""
        self._remember_state(session)
        session.dead = session.dead or "abandoned after a time-out"
        worker.stop()
        self._session = self._worker = None

    def _remember_state(self, session: CanSession) -> None:
        """Keep what outlives a session."""
        self._foreign_at_s = max(self._foreign_at_s, session.foreign_at_s)
        if session.emergency is not None or session.emergencies_cleared:
            self._emergency = session.emergency
