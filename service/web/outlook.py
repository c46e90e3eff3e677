"""What can be done here, and what it would bring: the catalogue and dry runs, without a device."""

import asyncio
from typing import Any

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter
from pydantic_core import to_jsonable_python

from procedures.catalogue import entry_named
from service.desk.messages import Name
from service.runs.outline import dry_run, possible
from service.web.door import Who, house_of

router = APIRouter()


@router.get("/procedures")
async def procedures(request: Request, who: Who, robot: str | None = None) -> list[dict[str, Any]]:
    """Return the catalogue: title, settings as JSON schema, and what this cell lacks for each."""
    del who
    house = house_of(request)
    found = await asyncio.to_thread(possible, house.config, robot)
    return [{**to_jsonable_python(each), "settings": _schema(each.name)} for each in found]


class Outlook(BaseModel):
    """Which run to foretell."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    procedure: Name
    robot: Name | None = None
    settings: dict[str, Any] = Field(default_factory=dict)


@router.post("/dry-runs")
async def foretell(asked: Outlook, request: Request, who: Who) -> dict[str, Any]:
    """Foretell a run: steps, poses, duration, predicted uncertainty, and what the cell lacks."""
    del who
    config = house_of(request).config
    told = await asyncio.to_thread(dry_run, config, asked.procedure, asked.settings, asked.robot)
    found: dict[str, Any] = to_jsonable_python(told)
    return found


def _schema(procedure: str) -> dict[str, Any]:
    return TypeAdapter(entry_named(procedure).spec_type).json_schema()
