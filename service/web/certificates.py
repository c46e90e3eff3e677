"""Certificates to read and to print: the signed file's page, PDF and text, made when they are asked for."""

import asyncio
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, HTMLResponse, Response

from service.certificates.certificate import issue
from service.certificates.printing import html_from, pdf_from
from service.web.door import Who, house_of

router = APIRouter()


@router.get(
    "/runs/{run_id}/certificate.pdf",
    response_class=Response,
    responses={200: {"content": {"application/pdf": {}}, "description": "PDF/A-2b"}},
)
async def certificate_pdf(run_id: str, request: Request, who: Who) -> Response:
    """Return the certificate of a run, or the record of its refusal, as PDF/A."""
    del who
    path = await _signed(request, run_id)
    content = await asyncio.to_thread(pdf_from, path)
    headers = {"content-disposition": f'inline; filename="{path.stem}.pdf"'}
    return Response(content, media_type="application/pdf", headers=headers)


@router.get("/runs/{run_id}/certificate.html", response_class=HTMLResponse)
async def certificate_html(run_id: str, request: Request, who: Who) -> HTMLResponse:
    """Return the certificate of a run, or the record of its refusal, as one page that prints on A4."""
    from service.certificates.html import POLICY  # noqa: PLC0415  not while the service starts

    del who
    content = await asyncio.to_thread(html_from, await _signed(request, run_id))
    policy = f"{POLICY}; frame-ancestors 'none'"
    return HTMLResponse(content, headers={"content-security-policy": policy})


@router.get("/runs/{run_id}/certificate.txt", response_class=FileResponse)
async def certificate_text(run_id: str, request: Request, who: Who) -> FileResponse:
    """Return the certificate of a run, or the record of its refusal, as plain text."""
    del who
    path = (await _signed(request, run_id)).with_suffix(".txt")
    return FileResponse(path, media_type="text/plain; charset=utf-8")


async def _signed(request: Request, run_id: str) -> Path:
    """Return the signed file, written anew where it was missing or spoilt."""
    return (await asyncio.to_thread(issue, house_of(request).config, run_id)).json_path
