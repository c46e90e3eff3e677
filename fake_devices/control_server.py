"""The control port: true state and faults for tests and the demo, one JSON object a line.

Imitates
    Nothing; no real cell has such a port, and no procedure can reach it.
Source
    Ours. ``{"do": "truth"}``, ``{"do": "fault", "name": …}``, ``{"do": "clear"}``, ``{"do": "faults"}``,
    ``{"do": "advance", "seconds": …}``, ``{"do": "pace", "time_factor": …}``, ``{"do": "tcp_error", "robot": …,
    "counts_at_zero": […], "poses": [[…]]}``.
Modelled
    A fault goes to the device that ``device`` names, or to the first one that knows it; ``link`` with a
    ``kind`` is another way to name a link fault.
    A line that is no JSON object ends the connection: a page in a browser can send none, since its first line
    is HTTP's.
Not modelled
    Several questions on one line.
"""

import asyncio
import json
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.device import FakeDevice, FaultRefusedError, JsonObject
from cellcal.fake_devices.listening_port import ListeningPort

_LINE_LIMIT_BYTES = 1 << 20
_ANSWERED = (ValueError, TypeError, AttributeError, OSError, ArithmeticError, LookupError, RuntimeError)


class ControlServer(ListeningPort):
    """A TCP server on loopback for one cell; an async context."""

    def __init__(self, cell: FakeCell, host: str = "127.0.0.1") -> None:
        super().__init__(host, cell.control_port, self._serve_client, line_limit_bytes=_LINE_LIMIT_BYTES)
        self._cell = cell
        self._verbs: dict[str, Callable[[JsonObject], Awaitable[JsonObject]]] = {
            "truth": self._report_truth,
            "fault": self._inject_fault,
            "faults": self._list_faults,
            "clear": self._clear_faults,
            "advance": self._advance_clock,
            "pace": self._set_time_factor,
            "tcp_error": self._tcp_error,
        }

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ValueError):  # a line beyond the limit
            while (
                (line := await reader.readline()).lstrip().startswith(b"{")
            ):  # a browser's request begins otherwise
                writer.write(json.dumps(await self.answer_line(line)).encode() + b"\n")
                await writer.drain()

    async def answer_line(self, line: bytes) -> JsonObject:
        """Return the answer to one line; a refusal, or a verb that fails, is ``{"error": …}``."""
        try:
            question = json.loads(line)
            verb = self._verbs[question.pop("do")]
            return {"ok": True, **await verb(question)}
        except KeyError as error:
            return {"error": f"unknown: {error}"}
        except _ANSWERED as error:  # FaultRefusedError is a ValueError
            return {"error": f"{error}" or type(error).__name__}

    async def _report_truth(self, _question: JsonObject) -> JsonObject:
        return {
            "time_s": self._cell.world.clock.now_s(),
            "time_factor": self._cell.world.clock.time_factor,
            "seed": self._cell.world.seed,
            "robots": {device.name: device.true_state() for device in self._cell.robots},
            "gauges": {device.name: device.true_state() for device in self._cell.gauges},
            "trackers": {device.name: device.true_state() for device in self._cell.trackers},
            "probes": {device.name: device.true_state() for device in self._cell.probes},
            "artefacts": {thing.name: thing.true_state() for thing in self._cell.world.artefacts},
        }

    async def _inject_fault(self, question: JsonObject) -> JsonObject:
        name, device_name = str(question.pop("name")), question.pop("device", None)
        if name == "link":
            name = str(question.pop("kind"))
        return await self._device_for(name, device_name).inject_fault(name, question)

    def _device_for(self, name: str, device_name: Any) -> FakeDevice:
        for device in self._cell.all_devices:
            if device_name in (None, device.name) and name in device.fault_names():
                return device
        where = "this cell" if device_name is None else repr(device_name)
        raise FaultRefusedError(f"nothing in {where} can show the fault {name!r}")

    async def _list_faults(self, _question: JsonObject) -> JsonObject:
        return {"faults": {device.name: sorted(device.fault_names()) for device in self._cell.all_devices}}

    async def _clear_faults(self, _question: JsonObject) -> JsonObject:
        for device in self._cell.all_devices:
            device.clear_faults()
        return {}

    async def _advance_clock(self, question: JsonObject) -> JsonObject:
        self._cell.world.clock.advance(float(question["seconds"]))
        await asyncio.sleep(0.0)
        return {"time_s": self._cell.world.clock.now_s()}

    async def _set_time_factor(self, question: JsonObject) -> JsonObject:
        clock = self._cell.world.clock
        clock.set_time_factor(float(question.get("time_factor", clock.time_factor)))
        return {"time_factor": clock.time_factor}

    async def _tcp_error(self, question: JsonObject) -> JsonObject:
        robot = question.get("robot") or next(iter(self._cell.world.masterings), None)
        if robot is None:
            raise FaultRefusedError("no robot of this cell has a mastering that could be wrong")
        errors = self._cell.world.tcp_error_m(robot, question.get("counts_at_zero"), question.get("poses"))
        return {"mean": float(errors.mean()), "max": float(errors.max()), "n": int(errors.size)}
