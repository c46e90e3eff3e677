"""What can be done here, and what it would bring: the catalogue and dry runs, without a device."""

import asyncio
import gzip
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from fastapi import APIRouter, FastAPI, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import to_jsonable_python
from starlette.requests import HTTPConnection

from cellcal.service.cell_process.messages import Name
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.review.compute_client import ComputeClient
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.response_models import (
    DryRunSeen,
    FiniteJsonResponse,
    Free,
    ProcedureSeen,
    response_options,
)
from cellcal.service.web.waiting_clients import answer_while_awaited

_PLANNER = "cellcal.service.web.preview_worker"
_LONGEST_PLAN_S = 180.0  # a calibration's poses on a machine with load 8; who leaves ends it sooner


@asynccontextmanager
async def _ended_with_the_service(app: FastAPI) -> AsyncIterator[None]:
    yield
    planner: ComputeClient | None = getattr(app.state, "planner", None)
    if planner is not None:
        await planner.stop_worker()


router = APIRouter(lifespan=_ended_with_the_service)


@router.get("/procedures", **response_options(list[ProcedureSeen], "the catalogue"))
async def get_procedures(request: Request, who: Who, robot: str | None = None) -> Response:
    """Return the catalogue: title, settings as JSON schema, and what this cell lacks for each."""
    del who
    packs = "gzip" in request.headers.get("accept-encoding", "").lower()
    lists, config = _procedure_lists(request), app_context(request).config
    body = await asyncio.to_thread(lists.list_bytes, config, robot, packs=packs)
    headers = {"vary": "Accept-Encoding"} | ({"content-encoding": "gzip"} if packs else {})
    return Response(body, headers=headers, media_type=FiniteJsonResponse.media_type)


class PreviewRequest(BaseModel):
    """The run to foretell."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    procedure: Name
    robot: Name | None = None
    settings: Free = Field(default_factory=dict)


@router.post("/dry-runs", **response_options(DryRunSeen, "what the run would do and bring"))
async def preview_run(requested: PreviewRequest, request: Request, who: Who) -> dict[str, Any]:
    """Foretell a run: steps, poses, duration, predicted uncertainty, and what the cell lacks."""
    del who
    question = {"procedure": requested.procedure, "robot": requested.robot, "settings": requested.settings}
    found: dict[str, Any] = await answer_while_awaited(
        request, _planner_of(request).ask_worker("dry run", **question)
    )
    return found


def _planner_of(connection: HTTPConnection) -> ComputeClient:
    """Return the process that plans for this service; the first question starts it."""
    state = connection.app.state
    if not hasattr(state, "planner"):
        state.planner = ComputeClient(
            app_context(connection).settings.cell_file, _PLANNER, longest_s=_LONGEST_PLAN_S
        )
    found: ComputeClient = state.planner
    return found


def _procedure_lists(connection: HTTPConnection) -> "ProcedureLists":
    state = connection.app.state
    if not hasattr(state, "procedure_lists"):
        state.procedure_lists = ProcedureLists()
    found: ProcedureLists = state.procedure_lists
    return found


class ProcedureLists:
    """The catalogue as it was last sent: schemas are made once, and only what has changed is written anew.

    What a cell lacks and what is due are looked up for every request.
    """

    def __init__(self) -> None:
        self._schemas: dict[str, dict[str, dict[str, Any]]] = {}  # by robot, by procedure
        self._sent: dict[
            str, tuple[Any, bytes, bytes]
        ] = {}  # by robot: what it was made of, plain and packed

    def list_bytes(self, config: CellConfig, robot: str | None, *, packs: bool) -> bytes:
        """Return the answer itself: schemas repeat themselves, and a slow link has enough to carry."""
        from cellcal.service.runs.run_preview import list_procedures  # noqa: PLC0415  heavy: not while the service starts

        named, rows = config.robot_named(robot).name, list_procedures(config, robot)
        made_of, plain, packed = self._sent.get(named, (None, b"", b""))
        if made_of != rows:
            plain = bytes(FiniteJsonResponse(self._with_settings(config, named, rows)).body)
            packed = gzip.compress(plain)
            self._sent[named] = rows, plain, packed
        return packed if packs else plain

    def _with_settings(self, config: CellConfig, robot: str, rows: Sequence[Any]) -> list[dict[str, Any]]:
        if robot not in self._schemas:
            self._schemas[robot] = {row.name: _settings_schema(config, robot, row.name) for row in rows}
        schemas = self._schemas[robot]
        return [{**to_jsonable_python(row), "settings": schemas[row.name]} for row in rows]


def _settings_schema(config: CellConfig, robot: str, procedure: str) -> dict[str, Any]:
    """Return the settings as JSON schema; those that are files say so; what the cell decides is the usual value."""
    from cellcal.procedures.catalogue import definition_named  # noqa: PLC0415  as above
    from cellcal.service.configuration.file_settings import file_settings, tag_settings  # noqa: PLC0415  as above
    from cellcal.service.engineering.measured.tag_files import WRITTEN  # noqa: PLC0415  as above
    from cellcal.service.runs.settings import chosen_by_cell  # noqa: PLC0415  as above
    from cellcal.service.runs.settings_description import schema_of  # noqa: PLC0415  as above

    kind = definition_named(procedure).spec_type
    schema = schema_of(procedure, chosen_by_cell(config, robot, procedure))
    for name in file_settings(kind):
        schema["properties"][name]["x-file"] = True
    for name in tag_settings(kind):
        schema["properties"][name]["x-tags"] = WRITTEN
    return schema
