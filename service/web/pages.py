"""The pages as they were built, from the package; nothing is loaded from another host."""

from pathlib import Path

from fastapi import FastAPI
from fastapi.middleware.gzip import GZipMiddleware
from fastapi.responses import PlainTextResponse
from fastapi.staticfiles import StaticFiles

DIST = Path(__file__).parent / "dist"
_NOT_BUILT = (
    "The pages of this copy of cellcal are not built. In a checkout: `make pages`, then start the service again. "
    "The service itself works; its description is at /openapi.json.\n"
)


def page_paths() -> frozenset[str]:
    """Return the paths at which built files are served; everybody may read them, they say nothing of the cell."""
    files = (file.relative_to(DIST).as_posix() for file in DIST.rglob("*") if file.is_file())
    return frozenset({"/", *(f"/{name}" for name in files)})


def add_pages(app: FastAPI) -> None:
    """Serve the pages at the root; say how to build them where they are missing."""
    if (DIST / "index.html").is_file():
        app.mount(
            "/", GZipMiddleware(StaticFiles(directory=DIST, html=True), minimum_size=1000), name="pages"
        )
    else:
        app.add_api_route(
            "/", lambda: PlainTextResponse(_NOT_BUILT, status_code=503), include_in_schema=False
        )
