"""A browser at a service over a fake cell that has a past."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import uvicorn
from playwright.async_api import async_playwright

from service.web.app import Settings, create_app
from service.web.pages import DIST
from tests.service.desks import PATIENCE_S, a_cell
from tests.service.reviewed import Past, with_a_past
from tests.service.test_pages import CHROMIUM, FLAGS, Looking


@asynccontextmanager
async def looking_back(folder: Path) -> AsyncIterator[tuple[Looking, Past]]:
    """Serve a cell whose journal holds runs, and look at it in Chromium."""
    assert CHROMIUM, "These tests look at the pages in Chromium: apt-get install chromium"
    assert (DIST / "index.html").is_file(), "The pages are not built: run `make pages`."
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        async with a_cell(folder) as (path, _), async_playwright() as playwright:
            past = await with_a_past(path)
            how = uvicorn.Config(
                create_app(Settings(path, open_access=True)), log_level="warning", ws="websockets-sansio",
                timeout_graceful_shutdown=2,
            )  # fmt: skip
            server = uvicorn.Server(how)
            serving = asyncio.create_task(server.serve([listening]))
            browser = await playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            looks = Looking(browser, f"http://127.0.0.1:{listening.getsockname()[1]}")
            looks.client.timeout = httpx.Timeout(PATIENCE_S)  # the first review starts the solver's process
            try:
                await looks.until(lambda session: session["connection"]["connected"])
                yield looks, past
            finally:
                await browser.close()
                await looks.client.aclose()
                server.should_exit = True
                await serving
