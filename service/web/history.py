"""What was done: runs, and their certificates. There is no way to delete anything here."""

import asyncio
from collections.abc import Collection
from typing import TYPE_CHECKING

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.legacy_texts import remember_recorded_texts
from cellcal.service.record.journal_files import lease_folder
from cellcal.service.record.robot_lock import runs_under_way
from cellcal.service.web import certificates, overlays, parameters, pictures, residuals, rollback, trends
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.response_models import RunDetail, RunLine, SignedDocument, response_options
from cellcal.service.web.worker import issue_certificate, open_journal, store_of

if TYPE_CHECKING:
    from cellcal.service.record.run_store import RunView

router = APIRouter()
for room in (certificates, parameters, pictures, rollback, residuals, overlays, trends):
    router.include_router(room.router)


@router.get("/runs", **response_options(list[RunLine], "all runs"))
async def list_runs(request: Request, who: Who) -> list[dict[str, object]]:
    """Return all runs of the cell, newest first."""
    del who
    return await asyncio.to_thread(_load_runs, app_context(request).config)


@router.get("/runs/{run_id}", **response_options(RunDetail, "one run"))
async def get_run(run_id: str, request: Request, who: Who) -> dict[str, object]:
    """Return one run: its settings, findings, result and verdict."""
    del who
    return await asyncio.to_thread(_load_run, app_context(request).config, run_id)


@router.get(
    "/runs/{run_id}/certificate.json",
    response_class=FileResponse,
    responses={200: {"model": SignedDocument, "description": "the signed document, as it was signed"}},
)
async def get_certificate(run_id: str, request: Request, who: Who) -> FileResponse:
    """Return the signed certificate of a run, or the record of its refusal."""
    del who
    issued = await asyncio.to_thread(issue_certificate, app_context(request).config, run_id)
    return FileResponse(issued.json_path, media_type="application/json", filename=issued.json_path.name)


def _load_runs(config: CellConfig) -> list[dict[str, object]]:
    with open_journal(config) as journal:
        views = store_of(journal).list_runs()
    under_way = runs_under_way(lease_folder(config))
    return [_run_line(view, under_way) for view in reversed(views)]


def _load_run(config: CellConfig, run_id: str) -> dict[str, object]:
    with open_journal(config) as journal:
        store = store_of(journal)
        view = store.find_run(store.resolve_run_id(run_id))
    document = {
        **_run_line(view, runs_under_way(lease_folder(config))),
        "spec": view.spec,
        "findings": [{"step": found.step, "value": found.value} for found in view.past.findings],
        "result": view.result,
        "judgement": view.judgement,
    }
    if not view.has_templates:
        remember_recorded_texts(document)
    return document


def _run_line(view: "RunView", under_way: Collection[str]) -> dict[str, object]:
    keys = ("run_id", "procedure", "started_utc", "reason", "begun_by", "begun_as")
    fields = {key: getattr(view, key) for key in keys}
    if not view.has_templates:
        remember_recorded_texts(view.reason)
    devices, word = view.cell["devices"], (view.judgement or {}).get("word", "")
    serial = devices[0]["identity"]["serial"] if devices else ""
    fields["state"] = view.state_seen(under_way)
    return {**fields, "word": word, "robot_serial": serial, "in_doubt": view.past.in_doubt or ""}
