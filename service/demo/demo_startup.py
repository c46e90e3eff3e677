"""How the demo begins: its technician takes the mastering record of the healthy robot, quickly, for all to see."""

import asyncio
import itertools
from collections.abc import Callable, Mapping

from cellcal.calibration.errors import CellError
from cellcal.service.demo.fake_cell import QUICKLY
from cellcal.service.demo.faults import ROBOT
from cellcal.service.demo.web_routes import DemoCellProcessClient
from cellcal.service.session_documents import SessionDocument

_WHO = "demo"
_PATIENCE_S = 120.0
_LOOK_S = 0.05


class DemoStartup:
    """Orders of the demo's technician, as a person at a screen gives them."""

    def __init__(self, link: DemoCellProcessClient, time_factor: float) -> None:
        self._link, self._time_factor = link, time_factor
        self._numbers = itertools.count(1)

    async def record_mastering(self) -> None:
        """Take the record; whatever keeps it from ending, the demo goes on without it."""
        world = self._link.world
        world.preparing = True
        try:
            async with asyncio.timeout(_PATIENCE_S):
                await world.fake_cell.send_command("pace", time_factor=max(QUICKLY, self._time_factor))
                await self._take_record()
        except (CellError, TimeoutError):
            return
        finally:
            world.preparing = False
            await world.fake_cell.send_command("pace", time_factor=self._time_factor)

    async def _take_record(self) -> None:
        await self._wait_until(lambda session: session["connection"]["connected"])
        settings = {"procedure": "mastering_record", "settings": {}, "hold_to_move": False}
        await self._send_order({"op": "start", **settings})
        while (await self._wait_until(lambda session: session["prompt"] or _has_ended(session)))["prompt"]:
            session = self._link.session
            prompt = None if session is None else session["prompt"]
            if prompt is not None:
                await self._send_order({"op": "answer", "prompt_id": prompt["id"], "value": "yes"})
        await self._send_order({"op": "dismiss"})

    async def _send_order(self, order: Mapping[str, object]) -> None:
        session = self._link.session
        rev = 0 if session is None else session["rev"]
        await self._link.send_order(
            {"id": f"opening {next(self._numbers)}", "rev": rev, "who": _WHO, "order": order}
        )

    async def _wait_until(self, true: Callable[[SessionDocument], object]) -> SessionDocument:
        while True:
            session = self._link.session
            if session is not None and session["robot"] == ROBOT and true(session):
                return session
            await asyncio.sleep(_LOOK_S)


def _has_ended(session: SessionDocument) -> bool:
    return session["run"] is None or session["run"]["state"] == "ended"
