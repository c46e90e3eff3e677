"""The pages as they were built, from the package; nothing is loaded from another host.

The build lays a packed copy beside each text (``.br``, ``.gz``): nothing is packed during a request.
"""

import os
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse, PlainTextResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import Headers
from starlette.staticfiles import NotModifiedResponse
from starlette.types import Scope

DIST = Path(__file__).parent / "dist"
PACKED = {"br": ".br", "gzip": ".gz"}  # best first
_FOR_EVER = "public, max-age=31536000, immutable"  # the name of an asset holds the hash of what is in it
_NOT_BUILT = (
    "The pages of this copy of cellcal are not built. In a checkout: `make pages`, then start the service again. "
    "The service itself works; its description is at /openapi.json.\n"
)


class BuiltFiles(StaticFiles):
    """Built files, packed as the browser takes them, kept by it for as long as they are true."""

    def file_response(
        self,
        full_path: "str | os.PathLike[str]",
        stat_result: os.stat_result,
        scope: Scope,
        status_code: int = 200,
    ) -> Response:
        request_headers = Headers(scope=scope)
        file, encoding = Path(full_path), None
        taken = {
            word.partition(";")[0].strip()
            for word in request_headers.get("accept-encoding", "").lower().split(",")
        }
        for name, ending in PACKED.items():
            packed = file.with_name(file.name + ending)
            if name in taken and packed.is_file():
                full_path, stat_result, encoding = packed, packed.stat(), name
                break
        headers = {
            "cache-control": _FOR_EVER if file.parent.name == "assets" else "no-cache",
            "vary": "Accept-Encoding",
        }
        if encoding is not None:
            headers["content-encoding"] = encoding
        kind = FileResponse(file).media_type
        response = FileResponse(
            full_path, status_code=status_code, headers=headers, media_type=kind, stat_result=stat_result
        )
        return (
            NotModifiedResponse(response.headers)
            if self.is_not_modified(response.headers, request_headers)
            else response
        )


def page_paths() -> frozenset[str]:
    """Return the paths at which built files are served; they need no sign-in and contain nothing of the cell."""
    files = (file for file in DIST.rglob("*") if file.is_file() and file.suffix not in PACKED.values())
    return frozenset({"/", *(f"/{file.relative_to(DIST).as_posix()}" for file in files)})


def add_pages(app: FastAPI) -> None:
    """Serve the pages at the root; say how to build them where they are missing."""
    if (DIST / "index.html").is_file():
        app.mount("/", BuiltFiles(directory=DIST, html=True), name="pages")
    else:
        app.add_api_route(
            "/", lambda: PlainTextResponse(_NOT_BUILT, status_code=503), include_in_schema=False
        )
