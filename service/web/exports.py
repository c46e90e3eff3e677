"""Tables to take away: runs, figures, readings and parameters as CSV or XLSX. Reading only."""

import asyncio
import re
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Request, Response

from cellcal.service.web.dependencies import Who, app_context

router = APIRouter(prefix="/exports")
Form = Literal["csv", "xlsx"]
Named = Annotated[str, Path(min_length=1, max_length=128)]
_XLSX = "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet"
_FILE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/csv": {}, _XLSX: {}}, "description": "CSV (UTF-8 with a mark) or XLSX"}
}


@router.get("/runs.{form}", response_class=Response, responses=_FILE)
async def export_runs(form: Form, request: Request, who: Who) -> Response:
    """Return all runs of the cell."""
    del who
    return await _table_response(request, "runs", form)


@router.get("/history.{form}", response_class=Response, responses=_FILE)
async def export_history(form: Form, request: Request, who: Who) -> Response:
    """Return every figure that a run ended with."""
    del who
    return await _table_response(request, "history", form)


@router.get("/runs/{run_id}/points.{form}", response_class=Response, responses=_FILE)
async def export_points(run_id: Named, form: Form, request: Request, who: Who) -> Response:
    """Return the readings of one run."""
    del who
    return await _table_response(request, "points", form, run_id)


@router.get("/parameters/{robot_serial}.{form}", response_class=Response, responses=_FILE)
async def export_parameters(robot_serial: Named, form: Form, request: Request, who: Who) -> Response:
    """Return all versions of a robot's parameters."""
    del who
    return await _table_response(request, "parameters", form, robot_serial)


async def _table_response(request: Request, what: str, form: Form, *named: str) -> Response:
    def build_table() -> tuple[bytes, str]:
        from cellcal.service.export import cell_tables  # noqa: PLC0415  heavy: not while the service starts
        from cellcal.service.export.table_files import CSV_TYPE, XLSX_TYPE, as_csv_file, as_xlsx_file  # noqa: PLC0415

        makers: dict[str, Any] = {
            "runs": cell_tables.runs_table,
            "history": cell_tables.history_table,
            "points": cell_tables.points_table,
            "parameters": cell_tables.parameters_table,
        }
        table = makers[what](app_context(request).config, *named)
        return (as_csv_file(table), CSV_TYPE) if form == "csv" else (as_xlsx_file([table]), XLSX_TYPE)

    content, kind = await asyncio.to_thread(build_table)
    name = re.sub(r"[^A-Za-z0-9_-]", "_", "-".join((what, *named)))
    headers = {"content-disposition": f'attachment; filename="{name}.{form}"'}
    return Response(content, media_type=kind, headers=headers)
