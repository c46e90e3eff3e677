"""``GET /metrics`` for a Prometheus server: for programs of this computer, or with the token of the cell file."""

import asyncio
import errno
import hmac
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, Response

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.service.export.exposition import CONTENT_TYPE
from cellcal.service.web.dependencies import app_context
from cellcal.service.web.middleware import is_loopback

router = APIRouter()
PATH = "/metrics"
SHORTEST_TOKEN = 24
_TEXTS: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {}}, "description": "Prometheus' text format 0.0.4"},
    401: {"content": {"text/plain": {}}, "description": "the token is missing or wrong"},
    403: {"content": {"text/plain": {}}, "description": "only programs on this computer may read it"},
}


@router.get(PATH, response_class=Response, responses=_TEXTS)
async def get_metrics(request: Request) -> Response:
    """Return the cell's figures in Prometheus' text format 0.0.4."""
    table = app_context(request).config.reports.metrics
    if table is None:
        client = request.client
        if client is None or not is_loopback(client.host):
            return _refuse_request(
                403, "only programs on this computer may read it; see [metrics] of the cell file."
            )
    elif not await asyncio.to_thread(_is_right, table.token_file, request.headers.get("authorization", "")):
        return _refuse_request(401, "the token is missing or wrong; see [metrics] of the cell file.")
    text = await asyncio.to_thread(request.app.state.meter.render_metrics)
    return Response(text, media_type=CONTENT_TYPE, headers={"cache-control": "no-store"})


def _is_right(file: Path, header: str) -> bool:
    """Compare with the file as it is now; one that cannot be used admits no request.

    Raises
    ------
    OSError
        This process has no descriptor to read it with: that says nothing of the token.
    """
    try:
        token = read_plain_text(file).partition("\n")[0].strip()
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            raise
        return False
    scheme, _, token_text = header.partition(" ")
    right = hmac.compare_digest(token_text.strip().encode(), token.encode())
    return len(token) >= SHORTEST_TOKEN and scheme.lower() == "bearer" and right


def _refuse_request(status: int, why: str) -> Response:
    headers = {"www-authenticate": "Bearer"} if status == 401 else {}
    return PlainTextResponse(f"{why}\n", status_code=status, headers=headers)
