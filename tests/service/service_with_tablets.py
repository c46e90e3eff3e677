"""The service with people, over a cell process, and a real browser whose contexts are tablets."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from playwright.async_api import Browser, BrowserContext, Page

from cellcal.service.people.authentication import Authenticator
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from cellcal.service.web.middleware import RequestBudget
from tests.service.browser_pages import (
    COUNT_ASKED,
    NO_WEBGL,
    PATIENCE_MS,
    PATIENCE_S,
    allow_many_requests,
    open_chromium,
    serve_app,
)
from tests.service.service_client import PINS, ROLES, cheap_hasher, what_was_begun_ends, with_people

ANSWERED = (
    "() => !document.querySelector('[data-testid=secret]')?.value"  # keys pressed before are rubbed out
)


@dataclass
class ServiceWithTablets:
    """The service as it runs, and the browser that looks at it."""

    app: FastAPI
    authenticator: Authenticator
    port: int
    browser: Browser
    complaints: list[str]

    def last_session(self) -> dict[str, Any] | None:
        """Return the last message of the cell process."""
        session: dict[str, Any] | None = self.app.state.context.link.session
        return session

    async def wait_until(self, true: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        """Wait until something is true of the session."""
        async with asyncio.timeout(PATIENCE_S):
            while True:
                with suppress(TypeError, KeyError):
                    session = self.last_session()
                    if session is not None and true(session):
                        return session
                await asyncio.sleep(0.02)

    def release_control(self) -> None:
        """Release what a person who left without signing out still has."""
        control = self.app.state.context.control
        if control.current_holder is not None:
            control.release_control(control.current_holder.id)

    @asynccontextmanager
    async def browser_context(
        self, locale: str = "en", size: tuple[int, int] = (1280, 800), **settings: Any
    ) -> AsyncIterator[BrowserContext]:
        """Open a browser that is not enrolled."""
        width, height = size
        context = await self.browser.new_context(viewport={"width": width, "height": height}, **settings)
        context.set_default_timeout(PATIENCE_MS)
        await context.add_init_script(
            f"localStorage.setItem('locale', '{locale}'); {NO_WEBGL}; {COUNT_ASKED}"
        )
        try:
            yield context
        finally:
            await context.close()

    @asynccontextmanager
    async def signed_in_tablet(
        self, name: str, *, port: int | None = None, **settings: Any
    ) -> AsyncIterator[Page]:
        """Enrol a tablet and sign a person in, as people do."""
        async with self.browser_context(**settings) as context:
            page = await context.new_page()
            page.on("pageerror", lambda error: self.complaints.append(str(error)))
            await self.enrol_tablet(page, f"tablet of {name}", port)
            await sign_in(page, name)
            yield page

    async def enrol_tablet(self, page: Page, device: str, port: int | None = None) -> None:
        """Open the address that an administrator gave, and press the button."""
        token = self.authenticator.accounts.create_enrolment(device, "test")
        await page.goto(f"http://127.0.0.1:{port or self.port}/#/enrol/{token}")
        await page.get_by_test_id("enrol-device").click()
        await page.get_by_test_id("enrolled").wait_for()


async def sign_in(page: Page, name: str, secret: str | None = None) -> None:
    """Pick a name and give the PIN."""
    await page.evaluate("location.hash = '#/sign-in'")
    await page.get_by_test_id("person").filter(has_text=name).click()
    await give_pin(page, secret or PINS[name])
    await page.locator(f"[data-testid=who][data-role={ROLES[name]}]").wait_for()


async def give_pin(page: Page, secret: str) -> None:
    """Press the keys of a PIN, or type a passphrase."""
    await page.get_by_test_id("secret").wait_for()
    if secret.isdigit():
        for digit in secret:
            await page.get_by_test_id(f"key-{digit}").click()
    else:
        await page.get_by_test_id("secret").fill(secret)
    await page.get_by_test_id("secret-enter").click()
    await page.wait_for_function(ANSWERED)


@asynccontextmanager
async def open_service_with_tablets(
    cell_file: Path,
    *,
    process_double: Callable[[FastAPI], Any] | None = None,
    clock: Callable[[], float] = time.monotonic,
    sign_ins: RequestBudget | None = None,
) -> AsyncIterator[ServiceWithTablets]:
    """Serve a cell to people; ``process_double`` puts a double in the place of the cell process; ``clock`` is of sessions.

    ``sign_ins`` says how many sign-ins all tablets together may ask for; as many as they like where it is None.
    """
    app = create_app(ServiceSettings(cell_file))
    allow_many_requests(app, **({} if sign_ins is None else {"sign-in": sign_ins}))
    authenticator = with_people(
        Authenticator(app.state.context.config.cell.data_dir, clock=clock, make_hasher=cheap_hasher)
    )
    app.state.context = replace(app.state.context, authenticator=authenticator)
    if process_double is not None:
        app.state.context = replace(app.state.context, link=process_double(app))
    async with AsyncExitStack() as stack:
        how = {"log_level": "critical", "lifespan": "off" if process_double else "on"}
        await stack.enter_async_context(what_was_begun_ends(app))
        url = await stack.enter_async_context(serve_app(app, **how))
        browser = await stack.enter_async_context(open_chromium())
        yield ServiceWithTablets(app, authenticator, int(url.rpartition(":")[2]), browser, [])
