"""Photos of a run: taken with the tablet, named in the journal by their hash, shown on the run's page."""

import asyncio
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response
from pydantic import BaseModel, ConfigDict, StringConstraints

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.measured.embedded_files import content_of
from cellcal.service.people.roles import Right
from cellcal.service.web.dependencies import Who, app_context, require_right
from cellcal.service.web.error_responses import RefusalResponse
from cellcal.service.web.worker import open_journal

router = APIRouter()
Sha256 = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$")]
_POLICY = "default-src 'none'; sandbox; frame-ancestors 'none'"


class PhotoUpload(BaseModel):
    """A photo as a page sends it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    what: Literal["witness marks"] = "witness marks"
    content_base64: Annotated[str, StringConstraints(min_length=4, max_length=250_000)]


class PhotoInfo(BaseModel):
    """A photo as the journal names it."""

    model_config = ConfigDict(frozen=True, from_attributes=True)

    sha256: str
    media_type: str
    bytes: int
    what: str
    who: str
    at_utc: str


@router.get("/runs/{run_id}/pictures")
async def list_pictures(run_id: str, request: Request, who: Who) -> list[PhotoInfo]:
    """Return the photos of a run, oldest first."""
    del who
    return await asyncio.to_thread(_load_pictures, app_context(request).config, run_id)


@router.post(
    "/runs/{run_id}/pictures",
    responses={403: {"model": RefusalResponse, "description": "the role does not include it"}},
)
async def upload_picture(run_id: str, taken: PhotoUpload, request: Request, who: Who) -> PhotoInfo:
    """Keep a photo with a run that is under way."""
    from cellcal.service.runs.photos import store_picture  # noqa: PLC0415  not while the service starts

    require_right(who, Right.RUN)
    raw, config = content_of(taken.content_base64, "the picture"), app_context(request).config
    stored = await asyncio.to_thread(store_picture, config, run_id, raw, what=taken.what, who=who.name)
    return PhotoInfo.model_validate(stored)


@router.get(
    "/runs/{run_id}/pictures/{sha256}",
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}, "image/png": {}}}},
)
async def get_picture(run_id: str, sha256: Sha256, request: Request, who: Who) -> Response:
    """Return one photo, as it was taken in."""
    del who
    content, media_type = await asyncio.to_thread(_load_picture, app_context(request).config, run_id, sha256)
    headers = {"content-security-policy": _POLICY, "content-disposition": "inline"}
    return Response(content, media_type=media_type, headers=headers)


def _load_pictures(config: CellConfig, run_id: str) -> list[PhotoInfo]:
    from cellcal.service.runs.photos import pictures_of_run  # noqa: PLC0415  not while the service starts

    with open_journal(config) as journal:
        return [PhotoInfo.model_validate(one) for one in pictures_of_run(journal.list_events(run_id))]


def _load_picture(config: CellConfig, run_id: str, sha256: str) -> tuple[bytes, str]:
    from cellcal.service.runs.photos import PictureError, pictures_of_run, read_picture  # noqa: PLC0415  as above

    with open_journal(config) as journal:
        matching = [one for one in pictures_of_run(journal.list_events(run_id)) if one.sha256 == sha256]
    if not matching:
        raise PictureError("this run has no such picture.")
    return read_picture(config, run_id, matching[0]), matching[0].media_type
