"""The demo's own buttons: what is made to happen to the fake cell, what was pressed, how wrong the tool really is.

These routes are there in a demo only. They command no robot: they change the world in which the fake devices play.
"""

from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field

from cellcal.calibration.errors import CellError
from cellcal.service.cell_process.messages import Name
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.demo.faults import DEMO_FAULTS, ROBOT, clear_faults, trigger_fault
from cellcal.service.demo.jogging import can_jog, jog_for
from cellcal.service.demo.technician_actions import perform_instruction
from cellcal.service.session_documents import CommandDocument, OnCellEvent, OrderReply, PromptDocument
from cellcal.service.web.cell_client import CellProcessClient
from cellcal.service.web.dependencies import Who, app_context

router = APIRouter(prefix="/demo")
_MOST_PRESSES = 50
CLEARED, JOGGED = "mended", "hand_jog"


class FaultRequest(BaseModel):
    """The button that was pressed."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name


class PaceRequest(BaseModel):
    """The factor by which the world's time is to run faster than real."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    time_factor: Annotated[float, Field(ge=1.0, le=2000.0)]


@dataclass(frozen=True, slots=True)
class PressRecord:
    """Something that was done to the world, by a button or by the technician's hands."""

    n: int
    at_utc: str
    name: str


@dataclass
class DemoWorld:
    """The fake world as the demo's pages reach it."""

    fake_cell: FakeCellClient
    pressed: deque[PressRecord] = field(default_factory=lambda: deque(maxlen=_MOST_PRESSES))
    preparing: bool = False  # the demo takes the mastering record by itself
    rng: np.random.Generator = field(default_factory=np.random.default_rng)  # of the technician's eye
    _count: int = 0

    def record_press(self, name: str) -> None:
        """Keep what was done."""
        self._count += 1
        self.pressed.appendleft(
            PressRecord(self._count, datetime.now(UTC).isoformat(timespec="seconds"), name)
        )

    async def to_json(self) -> dict[str, Any]:
        """Return what the demo's bar shows. The tool's error is the world's truth; no procedure can see it."""
        error = await self.fake_cell.send_command("tcp_error", robot=ROBOT)
        return {
            "faults": [{"name": each.name, "kind": each.kind, "device": each.device} for each in DEMO_FAULTS],
            "pressed": list(self.pressed),
            "preparing": self.preparing,
            "time_factor": (await self.fake_cell.send_command("pace"))["time_factor"],
            "tcp_error_m": {"robot": ROBOT, "mean": error["mean"], "max": error["max"]},
        }


class DemoCellProcessClient(CellProcessClient):
    """A client of the cell process with a technician: what a person confirms is done at the cabinet first."""

    def __init__(self, cell_file: Path, on_event: OnCellEvent, world: DemoWorld) -> None:
        super().__init__(cell_file, on_event)
        self.world = world

    async def send_order(self, command: CommandDocument) -> OrderReply:
        """Send a command; before a yes to an instruction, do what it asks for."""
        prompt = None if self.session is None else self.session["prompt"]
        if prompt is not None and self._is_yes(command, prompt):
            done = await perform_instruction(self.world.fake_cell, prompt["key"], prompt["text"])
            if done:
                self.world.record_press(f"hand_{done}")
        return await super().send_order(command)

    @property
    def jog_target(self) -> tuple[str, str, str] | None:
        """Robot, procedure and key of what is asked, where the technician can jog the arm there; else None."""
        session = self.session
        if session is None:
            return None
        run, prompt = session["run"], session["prompt"]
        if run is None or prompt is None:
            return None
        target = session["robot"], run["procedure"], prompt["key"]
        return target if can_jog(*target) else None

    async def jog_arm(self) -> None:
        """Bring the arm to where the step that is asked wants it."""
        target = self.jog_target
        if target is None:
            raise CellError(
                "no step that the demo's technician can jog the arm to is asked just now.",
                remedy="Look at the present step.",
                code="usage",
            )
        await jog_for(self.world.fake_cell, *target, self.world.rng)
        self.world.record_press(JOGGED)

    def _is_yes(self, command: CommandDocument, prompt: PromptDocument) -> bool:
        """Whether the cell process will accept this as the answer to its present question."""
        order, session = command["order"], self.session
        return (
            session is not None
            and order["op"] == "answer"
            and prompt["kind"] == "confirm"
            and prompt["id"] == order["prompt_id"]
            and session["rev"] == command["rev"]
        )


@dataclass(frozen=True)
class DemoExtension:
    """The demo's additions to the service: the routes of its buttons, and a line with hands."""

    fake_cell: FakeCellClient

    @property
    def router(self) -> APIRouter:
        """The routes of the demo's bar."""
        return router

    def make_link(self, cell_file: Path, on_event: OnCellEvent) -> CellProcessClient:
        """Return a line to the cell's process that does in the world what a person says was done."""
        return DemoCellProcessClient(cell_file, on_event, DemoWorld(self.fake_cell))


@router.get("")
async def show_demo(request: Request, who: Who) -> dict[str, Any]:
    """Return the faults that there are, what was pressed, the truth, and whether the arm can be jogged now."""
    del who
    return await _demo_state(request)


@router.post("/faults")
async def trigger_demo_fault(requested: FaultRequest, request: Request, who: Who) -> dict[str, Any]:
    """Let something happen to the fake cell."""
    del who
    world = _demo_link(request).world
    await trigger_fault(world.fake_cell, requested.name)
    world.record_press(requested.name)
    return await _demo_state(request)


@router.post("/jog")
async def jog_now(request: Request, who: Who) -> dict[str, Any]:
    """Let the technician bring the arm to where the step that is asked wants it."""
    del who
    await _demo_link(request).jog_arm()
    return await _demo_state(request)


@router.post("/mend")
async def mend_all(request: Request, who: Who) -> dict[str, Any]:
    """Put cables, wire, stops and switches back in order; what was lost stays lost."""
    del who
    world = _demo_link(request).world
    await clear_faults(world.fake_cell)
    world.record_press(CLEARED)
    return await _demo_state(request)


@router.post("/pace")
async def set_pace(pace: PaceRequest, request: Request, who: Who) -> dict[str, Any]:
    """Let the world's time run faster or slower."""
    del who
    await _demo_link(request).world.fake_cell.send_command("pace", time_factor=pace.time_factor)
    return await _demo_state(request)


async def _demo_state(request: Request) -> dict[str, Any]:
    link = _demo_link(request)
    return {**await link.world.to_json(), "can_jog": link.jog_target is not None}


def _demo_link(request: Request) -> DemoCellProcessClient:
    return cast(DemoCellProcessClient, app_context(request).link)
