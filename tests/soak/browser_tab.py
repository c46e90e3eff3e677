"""A tab of a real Chromium, enrolled once and then not touched: what it shows, as it shows it."""

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

from playwright.async_api import Page, WebSocket

from cellcal.service.people.accounts import AccountStore
from tests.service.browser_pages import NO_WEBGL, PATIENCE_MS, open_chromium

# Lines of the steps as [name, whether it is the current one, how many of it are done]; points of a page that teaches.
_TELL = """{ let told = '';
    const words = (e) => e.firstChild.textContent.trim();
    const look = () => {
        const lines = [...document.querySelectorAll('aside ol li')].map((li) => {
            const count = li.querySelector('.mono'), done = li.querySelector('.mark')?.textContent === '✓';
            return [words(li.children[1]), li.getAttribute('aria-current') === 'step',
                    count ? parseInt(count.textContent) : done ? 1 : 0]; });
        const points = [...document.querySelectorAll('[data-testid=points] li[data-state=recorded]')]
            .map((li) => li.innerText);
        const now = JSON.stringify({
            lines, points, online: !document.querySelector('[data-testid=offline]'),
            currents: document.querySelectorAll('aside [aria-current=step]').length});
        if (now !== told) window.__tell(told = now); };
    new MutationObserver(look).observe(
        document, {subtree: true, childList: true, attributes: true, characterData: true}); }"""


@dataclass(frozen=True)
class ShownRun:
    """A run as the tab shows it; without lines it shows none."""

    run: str = ""  # its id, which the tab was told and does not show
    online: bool = False
    currents: int = 0
    lines: tuple[tuple[str, bool, int], ...] = ()
    points: tuple[str, ...] = ()

    @property
    def current_step(self) -> str:
        """The name of the step that is the current one, empty for none."""
        return next((name for name, current, _ in self.lines if current), "")

    def missing_lines(self, before: "ShownRun") -> list[str]:
        """Return what was recorded before and is not any more; the current line may show no count."""
        now = {name: done for name, current, done in self.lines if not current}
        done_before = [(name, done) for name, _, done in before.lines if done and name != self.current_step]
        lost = [name for name, done in done_before if now.get(name, 0) < done]
        return lost + [point for point in before.points if self.points and point not in self.points]

    def went_on_from(self, before: "ShownRun") -> bool:
        """Whether it shows the step that was the current one, or more of it done."""
        was = {name: done for name, current, done in before.lines if current}
        return self.current_step in was or any(done > was.get(name, done) for name, _, done in self.lines)


@dataclass
class WatchedTab:
    """The tab; ``shown`` is what it shows now."""

    page: Page
    shown: ShownRun = field(default_factory=ShownRun)
    faults: list[str] = field(default_factory=list)
    _run: str = ""

    def on_change(self, payload: str) -> None:
        """Hear from the page that something on it has changed."""
        found = json.loads(payload)
        lines = tuple((name, current, done) for name, current, done in found["lines"])
        self.shown = ShownRun(self._run, found["online"], found["currents"], lines, tuple(found["points"]))
        if self.shown.currents > 1:
            self.faults.append(f"{self.shown.currents} steps are the current one")

    def follow_socket(self, socket: WebSocket) -> None:
        """Follow a socket that the page opened, for the name of the run that it is told of."""
        socket.on("framereceived", self._on_frame)

    def _on_frame(self, payload: str | bytes) -> None:
        message = json.loads(payload)
        if message["kind"] == "session":
            self._run = (message["content"]["run"] or {}).get("id") or ""


@asynccontextmanager
async def open_tab(data_dir: Path, port: int) -> AsyncIterator[WatchedTab]:
    """Open the service's page in a browser that was enrolled; without a sign-in, it looks on."""
    token = AccountStore(data_dir).create_enrolment("tab", "test")
    async with open_chromium() as browser:
        context = await browser.new_context(viewport={"width": 1280, "height": 800})
        context.set_default_timeout(PATIENCE_MS)
        page = await context.new_page()
        tab = WatchedTab(page)
        page.on("websocket", tab.follow_socket)
        page.on("pageerror", lambda error: tab.faults.append(str(error)))
        await page.expose_function("__tell", tab.on_change)
        await page.add_init_script(f"{NO_WEBGL}; {_TELL}")
        await page.goto(f"http://127.0.0.1:{port}/#/enrol/{token}")
        await page.get_by_test_id("enrol-device").click()
        await page.get_by_test_id("enrolled").wait_for()
        await page.goto(f"http://127.0.0.1:{port}/#/")
        yield tab
        await context.close()
