"""The demo's own buttons: what is made to happen to the fake cell, what was pressed, how wrong the tool really is.

These routes are there in a demo only. They command no robot: they change the world in which the fake devices play.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field

from cellcal.calibration.errors import CellError
from cellcal.service.cell_process.messages import Name
from cellcal.service.demo.door import Door
from cellcal.service.demo.hands import lend_a_hand
from cellcal.service.demo.jogging import can_jog, jog_for
from cellcal.service.demo.mishaps import MISHAPS, ROBOT, happen, mend
from cellcal.service.web.cell_client import DeskLink
from cellcal.service.web.door import Who, house_of

router = APIRouter(prefix="/demo")
_KEPT = 50
MENDED, JOGGED = "mended", "hand_jog"


class Wanted(BaseModel):
    """Which button was pressed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name


class Pace(BaseModel):
    """How much faster than real the world's time is to run."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    time_factor: Annotated[float, Field(ge=1.0, le=2000.0)]


@dataclass(frozen=True, slots=True)
class Pressed:
    """Something that was done to the world, by a button or by the technician's hands."""

    n: int
    at_utc: str
    name: str


@dataclass
class DemoWorld:
    """The fake world as the demo's pages reach it."""

    door: Door
    pressed: deque[Pressed] = field(default_factory=lambda: deque(maxlen=_KEPT))
    preparing: bool = False  # the demo takes the mastering record by itself
    dice: np.random.Generator = field(default_factory=np.random.default_rng)  # of the technician's eye
    _count: int = 0

    def note(self, name: str) -> None:
        """Keep what was done."""
        self._count += 1
        self.pressed.appendleft(Pressed(self._count, datetime.now(UTC).isoformat(timespec="seconds"), name))

    async def told(self) -> dict[str, Any]:
        """Return what the demo's bar shows. The tool's error is the world's truth; no procedure can see it."""
        error = await self.door.ask("tcp_error", robot=ROBOT)
        return {
            "mishaps": [{"name": each.name, "kind": each.kind, "device": each.device} for each in MISHAPS],
            "pressed": list(self.pressed),
            "preparing": self.preparing,
            "time_factor": (await self.door.ask("pace"))["time_factor"],
            "tcp_error_m": {"robot": ROBOT, "mean": error["mean"], "max": error["max"]},
        }


class DemoLink(DeskLink):
    """The line to the desk, with hands: what a person says is done at the cabinet is done in the world first."""

    def __init__(
        self, cell_file: Path, heard: Callable[[str, dict[str, Any]], None], world: DemoWorld
    ) -> None:
        super().__init__(cell_file, heard)
        self.world = world

    async def order(self, command: dict[str, Any]) -> dict[str, Any]:
        """Send a command; before a yes to an instruction, do what it asks for."""
        if self._is_yes(command):
            prompt = (self.session or {})["prompt"]
            done = await lend_a_hand(self.world.door, prompt["key"], prompt["text"])
            if done:
                self.world.note(f"hand_{done}")
        return await super().order(command)

    @property
    def touches(self) -> tuple[str, str, str] | None:
        """Robot, procedure and key of what is asked, where the technician can jog the arm there; else None."""
        session = self.session or {}
        run, prompt = session.get("run"), session.get("prompt")
        if run is None or prompt is None:
            return None
        asked = session["robot"], run["procedure"], prompt["key"]
        return asked if can_jog(*asked) else None

    async def jog(self) -> None:
        """Bring the arm to where the step that is asked wants it."""
        asked = self.touches
        if asked is None:
            raise CellError(
                "no step that the demo's technician can jog the arm to is asked just now.",
                remedy="Look at the present step.",
                code="usage",
            )
        await jog_for(self.world.door, *asked, self.world.dice)
        self.world.note(JOGGED)

    def _is_yes(self, command: dict[str, Any]) -> bool:
        """Whether the desk will take this as the answer to what it asks just now."""
        order, session = command["order"], self.session or {}
        prompt = session.get("prompt")
        return (
            order["op"] == "answer"
            and prompt is not None
            and prompt["kind"] == "confirm"
            and prompt["id"] == order["prompt_id"]
            and session["rev"] == command["rev"]
        )


@dataclass(frozen=True)
class DemoExtension:
    """What a demo adds to the service: the routes of its buttons, and a line with hands."""

    door: Door

    @property
    def router(self) -> APIRouter:
        """The routes of the demo's bar."""
        return router

    def make_link(self, cell_file: Path, on_event: Callable[[str, dict[str, Any]], None]) -> DeskLink:
        """Return a line to the cell's process that does in the world what a person says was done."""
        return DemoLink(cell_file, on_event, DemoWorld(self.door))


@router.get("")
async def shown(request: Request, who: Who) -> dict[str, Any]:
    """Return the mishaps that there are, what was pressed, the truth, and whether the arm can be jogged now."""
    del who
    return await _told(request)


@router.post("/mishaps")
async def let_happen(wanted: Wanted, request: Request, who: Who) -> dict[str, Any]:
    """Let something happen to the fake cell."""
    del who
    world = _link(request).world
    await happen(world.door, wanted.name)
    world.note(wanted.name)
    return await _told(request)


@router.post("/jog")
async def jog(request: Request, who: Who) -> dict[str, Any]:
    """Let the technician bring the arm to where the step that is asked wants it."""
    del who
    await _link(request).jog()
    return await _told(request)


@router.post("/mend")
async def mend_all(request: Request, who: Who) -> dict[str, Any]:
    """Put cables, wire, stops and switches back in order; what was lost stays lost."""
    del who
    world = _link(request).world
    await mend(world.door)
    world.note(MENDED)
    return await _told(request)


@router.post("/pace")
async def set_pace(pace: Pace, request: Request, who: Who) -> dict[str, Any]:
    """Let the world's time run faster or slower."""
    del who
    await _link(request).world.door.ask("pace", time_factor=pace.time_factor)
    return await _told(request)


async def _told(request: Request) -> dict[str, Any]:
    link = _link(request)
    return {**await link.world.told(), "can_jog": link.touches is not None}


def _link(request: Request) -> DemoLink:
    return cast(DemoLink, house_of(request).link)
