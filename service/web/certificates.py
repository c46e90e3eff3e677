"""Certificates to read and to print: the signed file's page, PDF and text, made when they are asked for."""

import asyncio
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse, HTMLResponse, Response
from pydantic import BaseModel, ConfigDict

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.signing import CheckFinding, check_document, read_document, station_key
from cellcal.service.translation import Locale
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.worker import issue_certificate, open_journal, store_of

router = APIRouter()


class CertificateCheck(BaseModel):
    """The outcome of a check of the signed file on this computer's disk."""

    model_config = ConfigDict(frozen=True)

    run_id: str
    word: str  # pass, fail, undecided, refused; empty where the file is not intact
    finding: CheckFinding
    sentence: str
    sha256: str
    public_key: str  # of the signer
    by_this_cell: bool  # with the key that this cell signs with today


@router.get("/runs/{run_id}/certificate/check")
async def certificate_check(run_id: str, request: Request, who: Who) -> CertificateCheck:
    """Check the signed file as it lies on the disk, to the last byte; as `cellcal verify` does."""
    del who
    return await asyncio.to_thread(_check_certificate, app_context(request).config, run_id)


def _check_certificate(config: CellConfig, run_id: str) -> CertificateCheck:
    from cellcal.service.record.journal_files import certificates_folder  # noqa: PLC0415  not while the service starts

    with open_journal(config) as journal:
        store = store_of(journal)
        full_run_id = store.find_run(store.resolve_run_id(run_id)).run_id
    names = [certificates_folder(config) / f"{full_run_id}{end}.json" for end in ("", "-refused")]
    path = (
        next((name for name in names if name.exists()), None)
        or issue_certificate(config, full_run_id).json_path
    )
    raw = read_document(path)
    found = check_document(raw) if isinstance(raw, bytes) else raw
    content = found.content if isinstance(found.content, dict) else {}
    return CertificateCheck(
        run_id=full_run_id,
        word=str(content.get("verdict", {}).get("word", "")),
        finding=found.finding,
        sentence=found.sentence,
        sha256=found.sha256,
        public_key=found.public_key,
        by_this_cell=found.public_key == station_key(config.cell.data_dir).public_key,
    )


@router.get(
    "/runs/{run_id}/certificate.pdf",
    response_class=Response,
    responses={200: {"content": {"application/pdf": {}}, "description": "PDF/A-2b"}},
)
async def certificate_pdf(run_id: str, request: Request, who: Who, language: Locale = "en") -> Response:
    """Return the certificate of a run, or the record of its refusal, as PDF/A."""
    from cellcal.service.certificates.printing import pdf_from  # noqa: PLC0415  not while the service starts

    del who
    path = await _signed_file(request, run_id)
    content = await asyncio.to_thread(pdf_from, path, language)
    headers = {"content-disposition": f'inline; filename="{path.stem}.pdf"'}
    return Response(content, media_type="application/pdf", headers=headers)


@router.get(
    "/runs/{run_id}/certificate.html",
    response_class=Response,
    responses={200: {"content": {"text/html": {}}, "description": "one page that prints on A4"}},
)
async def certificate_html(run_id: str, request: Request, who: Who, language: Locale = "en") -> HTMLResponse:
    """Return the certificate of a run, or the record of its refusal, as one page that prints on A4."""
    from cellcal.service.certificates.html import POLICY  # noqa: PLC0415  not while the service starts
    from cellcal.service.certificates.printing import html_from  # noqa: PLC0415  as above

    del who
    content = await asyncio.to_thread(html_from, await _signed_file(request, run_id), language)
    policy = f"{POLICY}; frame-ancestors 'none'"
    return HTMLResponse(content, headers={"content-security-policy": policy})


@router.get(
    "/runs/{run_id}/certificate.txt",
    response_class=FileResponse,
    responses={200: {"content": {"text/plain": {}}, "description": "the certificate in words"}},
)
async def certificate_text(run_id: str, request: Request, who: Who) -> FileResponse:
    """Return the certificate of a run, or the record of its refusal, as plain text."""
    del who
    path = (await _signed_file(request, run_id)).with_suffix(".txt")
    return FileResponse(path, media_type="text/plain; charset=utf-8")


async def _signed_file(request: Request, run_id: str) -> Path:
    """Return the signed file, written anew where it was missing or spoilt."""
    return (await asyncio.to_thread(issue_certificate, app_context(request).config, run_id)).json_path
