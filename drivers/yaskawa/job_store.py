"""Jobs (.JBI) on a Yaskawa controller, over the file port of the High Speed Ethernet Server.

Sources: 160766-1CD and HW1483358 as yrcom lays them out (services 0x32, 0x16, 0x15, 0x09 and their blocks). Writing
needs *command remote*; whether a controller writes over a job that is there is not known: where it refuses, the old
one stays.
"""

import asyncio
from typing import Self

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.yaskawa.hses_frames import FILE_DIVISION, FILE_PORT, ROBOT_DIVISION, ROBOT_PORT
from cellcal.drivers.yaskawa.hses_link import HsesLink
from cellcal.drivers.yaskawa.state import read_status

_JOBS = "*.JBI"


class YaskawaJobStore:
    """The jobs of one controller; a context that opens both sockets."""

    tells_running = True

    def __init__(self, device: str, address: str, *, port: int = ROBOT_PORT, timeout_s: float) -> None:
        file_port = port + (FILE_PORT - ROBOT_PORT)
        self._link = HsesLink(device, address, port, ROBOT_DIVISION, deadline_s=timeout_s)
        self._files = HsesLink(device, address, file_port, FILE_DIVISION, deadline_s=timeout_s)

    async def __aenter__(self) -> Self:
        await self._link.open()
        try:
            await self._files.open()
        except BaseException:
            self._link.close()
            raise
        return self

    async def __aexit__(self, *_exc: object) -> None:
        self._files.close()
        self._link.close()
        await asyncio.sleep(0)  # the sockets are closed in the loop's next turn

    @property
    def device(self) -> str:
        return self._link.device

    async def list_names(self) -> tuple[str, ...]:
        text = (await self._files.list_files(_JOBS)).decode("latin-1")
        return tuple(
            sorted(line.strip() for line in text.splitlines() if line.strip().upper().endswith(".JBI"))
        )

    async def read_file(self, name: str) -> bytes | None:
        there = {one.upper(): one for one in await self.list_names()}
        found = there.get(name.upper())
        return None if found is None else await self._files.read_file(found)

    async def write_file(self, name: str, content: bytes) -> None:
        await self._files.write_file(name, content)

    async def delete_file(self, name: str) -> None:
        if await self.read_file(name) is not None:
            await self._files.delete_file(name)

    async def refuse_while_running(self) -> None:
        if (await read_status(self._link)).is_running:
            raise RefusedError(
                self.device,
                "a job runs, or the robot moves.",
                remedy="Stop it at the pendant, then deliver again.",
            )

    def is_same(self, sent: bytes, read: bytes) -> bool:
        return sent.splitlines() == read.splitlines()
