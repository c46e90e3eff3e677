"""What can be done here, and what it would bring: the catalogue and dry runs, without a device."""

import asyncio
import gzip
from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import to_jsonable_python

from cellcal.service.cell_process.messages import Name
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.response_models import (
    DryRunSeen,
    FiniteJsonResponse,
    Free,
    ProcedureSeen,
    response_options,
)

router = APIRouter()


@router.get("/procedures", **response_options(list[ProcedureSeen], "the catalogue"))
async def get_procedures(request: Request, who: Who, robot: str | None = None) -> Response:
    """Return the catalogue: title, settings as JSON schema, and what this cell lacks for each."""
    del who
    packs = "gzip" in request.headers.get("accept-encoding", "").lower()
    return await asyncio.to_thread(_catalogue_response, app_context(request).config, robot, packs=packs)


class PreviewRequest(BaseModel):
    """Which run to foretell."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    procedure: Name
    robot: Name | None = None
    settings: Free = Field(default_factory=dict)


@router.post("/dry-runs", **response_options(DryRunSeen, "what the run would do and bring"))
async def preview_run(requested: PreviewRequest, request: Request, who: Who) -> dict[str, Any]:
    """Foretell a run: steps, poses, duration, predicted uncertainty, and what the cell lacks."""
    del who
    config = app_context(request).config
    return await asyncio.to_thread(_preview_to_json, config, requested)


def _catalogue_response(config: CellConfig, robot: str | None, *, packs: bool) -> Response:
    """Return the answer itself: schemas repeat themselves, and a slow link has enough to carry."""
    body, headers = FiniteJsonResponse(_procedure_rows(config, robot)).body, {"vary": "Accept-Encoding"}
    if packs:
        body, headers = gzip.compress(body), {**headers, "content-encoding": "gzip"}
    return Response(body, headers=headers, media_type=FiniteJsonResponse.media_type)


def _procedure_rows(config: CellConfig, robot: str | None) -> list[dict[str, Any]]:
    from cellcal.service.runs.run_preview import list_procedures  # noqa: PLC0415  heavy: not while the service starts

    named = config.robot_named(robot).name
    return [
        {**to_jsonable_python(each), "settings": _settings_schema(config, named, each.name)}
        for each in list_procedures(config, robot)
    ]


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


def _preview_to_json(config: CellConfig, requested: PreviewRequest) -> dict[str, Any]:
    from cellcal.procedures.catalogue import definition_named  # noqa: PLC0415  heavy: not while the service starts
    from cellcal.service.engineering.parameters.simulated_cells import refuse_paths  # noqa: PLC0415  as above
    from cellcal.service.runs.run_preview import dry_run  # noqa: PLC0415  as above

    refuse_paths(definition_named(requested.procedure).spec_type, requested.settings)
    found: dict[str, Any] = to_jsonable_python(
        dry_run(config, requested.procedure, requested.settings, requested.robot)
    )
    return found
