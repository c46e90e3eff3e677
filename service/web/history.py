"""What was done: runs, and their certificates. There is no way to delete anything here."""

import asyncio
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.web import certificates, overlays, parameters, pictures, residuals, rollback, trends
from cellcal.service.web.door import Who, house_of
from cellcal.service.web.response_models import RunDetail, RunLine, SignedDocument, answering
from cellcal.service.web.worker import issue, open_journal, store_of

if TYPE_CHECKING:
    from cellcal.service.record.run_store import RunView

router = APIRouter()
for room in (certificates, parameters, pictures, rollback, residuals, overlays, trends):
    router.include_router(room.router)


@router.get("/runs", **answering(list[RunLine], "all runs"))
async def runs(request: Request, who: Who) -> list[dict[str, Any]]:
    """Return all runs of the cell, newest first."""
    del who
    return await asyncio.to_thread(_runs, house_of(request).config)


@router.get("/runs/{run_id}", **answering(RunDetail, "one run"))
async def run(run_id: str, request: Request, who: Who) -> dict[str, Any]:
    """Return one run: its settings, findings, result and verdict."""
    del who
    return await asyncio.to_thread(_run, house_of(request).config, run_id)


@router.get(
    "/runs/{run_id}/certificate.json",
    response_class=FileResponse,
    responses={200: {"model": SignedDocument, "description": "the signed document, as it was signed"}},
)
async def certificate(run_id: str, request: Request, who: Who) -> FileResponse:
    """Return the signed certificate of a run, or the record of its refusal."""
    del who
    issued = await asyncio.to_thread(issue, house_of(request).config, run_id)
    return FileResponse(issued.json_path, media_type="application/json", filename=issued.json_path.name)


def _runs(config: CellConfig) -> list[dict[str, Any]]:
    with open_journal(config) as journal:
        return [_short(view) for view in reversed(store_of(journal).runs())]


def _run(config: CellConfig, run_id: str) -> dict[str, Any]:
    with open_journal(config) as journal:
        store = store_of(journal)
        view = store.run(store.newest(run_id))
    return {
        **_short(view),
        "spec": view.spec,
        "findings": [{"step": found.step, "value": found.value} for found in view.past.findings],
        "result": view.result,
        "judgement": view.judgement,
    }


def _short(view: "RunView") -> dict[str, Any]:
    keys = ("run_id", "procedure", "started_utc", "state", "reason", "begun_by", "begun_as")
    told = {key: getattr(view, key) for key in keys}
    devices, word = view.cell["devices"], (view.judgement or {}).get("word", "")
    return {**told, "word": word, "robot_serial": devices[0]["identity"]["serial"] if devices else ""}
