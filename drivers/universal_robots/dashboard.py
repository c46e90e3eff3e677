"""The controller's dashboard: one question, one line of answer.

Each question uses a connection of its own, so that ``stop_program`` has a path to the robot that nothing else can
block: not a hanging library, not a dead child process, not a lost RTDE link.

Source: the maker's dashboard server article for e-Series.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, UnreachableError, WireProtocolError
from cellcal.drivers.universal_robots.state import CABLE
from cellcal.drivers.wire.link_errors import find_reason

PORT = 29999
_LONGEST_LINE = 4096
_ASK_TO_REPORT = "Report this with the controller's version; nothing in the cell is at fault."


class UrDashboard:
    """The dashboard commands that are used, and no more: it could also release brakes and clear stops."""

    def __init__(self, device: str, address: str, *, deadline_s: float) -> None:
        self._device, self._address, self._deadline_s = device, address, deadline_s

    async def serial_number(self) -> str:
        """Return the serial number of the arm."""
        return await self._ask_dashboard("get serial number")

    async def read_model(self) -> str:
        """Return the size of the arm, ``UR10`` also for a UR10e."""
        return await self._ask_dashboard("get robot model")

    async def in_remote_control(self) -> bool:
        """Whether the pendant has handed control to the network."""
        reply = await self._ask_dashboard("is in remote control")
        if reply.lower() not in ("true", "false"):
            raise WireProtocolError(
                self._device, "the dashboard answered neither true nor false.",
                remedy=_ASK_TO_REPORT, frame=reply.encode().hex(),
            )  # fmt: skip
        return reply.lower() == "true"

    async def is_program_active(self) -> bool:
        """Whether a program runs or is paused, so that it may go on."""
        reply = await self._ask_dashboard("programState")
        state = reply.upper().partition(" ")[0]
        if state not in ("STOPPED", "PLAYING", "PAUSED"):
            raise WireProtocolError(
                self._device, "the dashboard does not say whether a program runs.",
                remedy=_ASK_TO_REPORT, frame=reply.encode().hex(),
            )  # fmt: skip
        return state != "STOPPED"

    async def stop_program(self) -> None:
        """Stop whatever program runs; the arm decelerates and stays where it is."""
        reply = await self._ask_dashboard("stop")
        if not reply.lower().startswith("stopped"):
            raise RefusedError(
                self._device, make_message('the controller refused to stop its program: "{reply}".', reply=reply),
                remedy="Stop the robot at the pendant.", vendor_text=reply,
            )  # fmt: skip

    async def _ask_dashboard(self, question: str) -> str:
        async with self._open_connection() as (reader, writer):
            await _read_line(reader)  # the greeting
            writer.write(question.encode() + b"\n")
            return await _read_line(reader)

    @asynccontextmanager
    async def _open_connection(self) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
        writer: asyncio.StreamWriter | None = None
        try:
            async with asyncio.timeout(self._deadline_s):
                reader, writer = await asyncio.open_connection(self._address, PORT, limit=_LONGEST_LINE)
                yield reader, writer
        except TimeoutError:
            raise self._unreachable_error(
                make_message("did not answer within {deadline_s:g} s", deadline_s=self._deadline_s)
            ) from None
        except (OSError, EOFError) as error:
            what = make_message("cannot be reached ({error})", error=find_reason(error))
            raise self._unreachable_error(what) from error
        except ValueError as error:
            raise WireProtocolError(
                self._device,
                make_message("the dashboard sent a line that is too long ({error}).", error=error),
                remedy=_ASK_TO_REPORT,
            ) from error
        finally:
            if writer is not None:
                writer.close()
                with contextlib.suppress(OSError):
                    await writer.wait_closed()

    def _unreachable_error(self, what: str) -> UnreachableError:
        return UnreachableError(
            self._device,
            make_message(
                "the dashboard of the controller at {address} {what}.", address=self._address, what=what
            ),
            remedy=CABLE,
        )


async def _read_line(reader: asyncio.StreamReader) -> str:
    line = await reader.readline()
    if not line.endswith(b"\n"):
        raise EOFError("it hung up")
    return line.decode("utf-8", errors="replace").strip()
