"""How long a page takes from a tap until it can be used: ``python -m tests.benchmarks.bench_pages --busy 4``.

Chromium taps each procedure on the first page of a demo; the page counts, from the tap until its fields and buttons
are drawn, on its own clock. ``--busy`` processes that only count compete for the processor meanwhile.
"""

import argparse
import asyncio
import json
import os
import subprocess
import sys
from statistics import median

from playwright.async_api import Page

from tests.benchmarks.bench_routes import served_demo
from tests.service.browser_pages import NO_WEBGL, PATIENCE_MS, at_rest, go_to_page, open_chromium

_TAP = """async (link) => {
    const began = performance.now();
    link.click();
    const drawn = () => new Promise(done => requestAnimationFrame(() => setTimeout(done)));
    do await drawn(); while (location.hash !== link.hash || !document.querySelector('main [data-testid=start]'));
    return performance.now() - began;
}"""
_LINKS = "main a.button[href^='#/procedure/']"


async def time_taps(url: str, rounds: int) -> dict[str, list[float]]:
    """Return for each procedure how long it took from a tap on the first page [ms]."""
    async with open_chromium(whole=True) as browser:
        page = await browser.new_page(viewport={"width": 800, "height": 1280})
        await page.add_init_script(NO_WEBGL)
        await page.goto(url, timeout=PATIENCE_MS)
        await page.locator(_LINKS).first.wait_for(state="attached", timeout=PATIENCE_MS)
        taken: dict[str, list[float]] = {}
        for _ in range(rounds):
            for place in range(await page.locator(_LINKS).count()):
                name, time_ms = await _tap(page, place)
                taken.setdefault(name, []).append(time_ms)
        return taken


async def _tap(page: Page, place: int) -> tuple[str, float]:
    link = page.locator(_LINKS).nth(place)
    await link.wait_for(state="attached", timeout=PATIENCE_MS)  # its group may be closed
    name = str(await link.get_attribute("href")).rpartition("/")[2]
    time_ms = float(await link.evaluate(_TAP))
    await at_rest(page)
    await go_to_page(page, "#/")
    return name, time_ms


def main() -> None:
    """Print a line a procedure and, last, one JSON line."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--rounds", type=int, default=3, help="how often each procedure is tapped")
    options.add_argument("--busy", type=int, default=0, help="processes that compete for the processor")
    chosen = options.parse_args()
    counting = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(chosen.busy)]
    try:
        with served_demo() as client:
            found = asyncio.run(time_taps(str(client.base_url), chosen.rounds))
    finally:
        for process in counting:
            process.kill()
            process.wait()
    every = [time_ms for times in found.values() for time_ms in times]
    for name, times in found.items():
        sys.stdout.write(f"{median(times):8.0f} {max(times):8.0f}  {name}\n")
    figures = {"taps": len(every), "median_ms": median(every), "worst_ms": max(every), "busy": chosen.busy}
    sys.stdout.write(json.dumps({**figures, "load": os.getloadavg()[0]}) + "\n")


if __name__ == "__main__":
    main()
