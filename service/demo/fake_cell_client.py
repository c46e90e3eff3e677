"""A client of the fake cell's control port: faults, time, and for tests and the demo the truth."""

import asyncio
import json
from typing import Any

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message


class FakeCellClient:
    """One JSON object a line in, one out. No procedure gets hold of this."""

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port

    async def send_command(self, verb: str, **arguments: Any) -> dict[str, Any]:
        """Send one command and return its answer; raise CellError with its text where it refuses."""
        async with asyncio.timeout(60.0):
            reader, writer = await asyncio.open_connection(self.host, self.port)
            try:
                writer.write(json.dumps({"do": verb, **arguments}).encode() + b"\n")
                await writer.drain()
                answer: dict[str, Any] = parse_json(await reader.readline() or b'{"error": "no answer"}')
            finally:
                writer.close()
                await writer.wait_closed()
        if "error" in answer:
            raise CellError(
                make_message("the fake cell refused {verb!r}: {answer}", verb=verb, answer=answer["error"]),
                code="fake",
            )
        return answer

    async def inject_fault(self, name: str, **arguments: Any) -> dict[str, Any]:
        """Let something go wrong in the world."""
        return await self.send_command("fault", name=name, **arguments)

    async def read_truth(self) -> dict[str, Any]:
        """Return what no procedure may know."""
        return await self.send_command("truth")
