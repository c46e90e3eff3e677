"""kill -9 of the service at random instants, in a browser's view: the same step, no point lost or doubled."""

import asyncio
import json
import random
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from procedures.past import Kind
from service.runs.journal import Journal
from service.runs.store import Store
from tests.service.desks import a_cell
from tests.soak.figures import Figures
from tests.soak.served import Browser, Service, free_port, serving

LONGEST_LIFE = 70  # sessions that a browser is shown before a kill: a whole record and the start of the next
WHAT = ("service", "desk", "both")  # the web process, the cell's process, or the computer's power


@dataclass
class Lives:
    """What was seen over many kills."""

    kills: Counter[str] = field(default_factory=Counter)
    captures: int = 0
    under_way: int = 0  # kills that hit a run
    longest_s: float = 0.0  # from the kill until the same step was shown again
    wrong: list[str] = field(default_factory=list)


def desk_kills(kills: int) -> Figures:
    """Kill the service so often while it takes records one after the other."""
    with tempfile.TemporaryDirectory() as folder:
        seen = asyncio.run(kill_and_look(Path(folder), kills, seed=5))
    told = ", ".join(f"{count} of the {what}" for what, count in sorted(seen.kills.items()))
    line = (
        f"desk_kills: {kills} kills ({told}), {seen.under_way} of them in a run, {seen.captures} captures stored; "
        f"{len(seen.wrong)} times another step, a lost or a doubled point (must be 0) {seen.wrong[:3]}; "
        f"longest until the page was right again {seen.longest_s:.1f} s"
    )
    return Figures(line, not seen.wrong and seen.under_way > kills / 2)


async def kill_and_look(folder: Path, kills: int, seed: int, *, longest_life: int = LONGEST_LIFE) -> Lives:
    """Kill and restart; after each kill the page must show what it showed before."""
    dice, seen, stored = random.Random(seed), Lives(), dict[str, list[tuple[str, Any]]]()
    port = free_port()
    async with a_cell(folder, time_factor=1000.0) as (path, _):
        journal = folder / "data"
        shown: dict[str, Any] | None = None
        while sum(seen.kills.values()) < kills:
            async with serving(path, port) as (service, client):
                browser = Browser(client)
                while sum(seen.kills.values()) < kills:
                    await _same_again(browser, shown, journal, seen)
                    browser.count = 0
                    life = dice.randrange(1, longest_life)
                    await browser.look_until(lambda b=browser, n=life: b.count >= n)  # type: ignore[misc]
                    await asyncio.sleep(dice.choice((0.0, dice.random() / 4)))
                    shown, what = browser.session, dice.choice(WHAT)
                    _kill(service, what)
                    seen.kills[what] += 1
                    seen.under_way += _under_way(shown) is not None
                    if what != "desk":
                        break
                    browser.session = None
                    await browser.look_until(lambda b=browser: b.session is None, orders=False)  # type: ignore[misc]
                await service.process.wait() if what != "desk" else None
            seen.wrong += _journal_faults(journal, stored)
            _tell(seen)
        async with serving(path, port) as (_, client):
            browser = Browser(client)
            await _same_again(browser, shown, journal, seen)
            await browser.look_until(lambda: _has_ended(browser.session))
            assert browser.session is not None
            if browser.session["run"]["outcome"]["verdict"] != "passed":
                seen.wrong.append(f"the last run ended as {browser.session['run']['outcome']}")
        seen.wrong += _journal_faults(journal, stored)
    seen.captures = sum(step.startswith("capture") for steps in stored.values() for step, _ in steps)
    return seen


def _tell(seen: Lives) -> None:
    """Say how far it is: a campaign takes its time."""
    sys.stderr.write(
        f"{sum(seen.kills.values())} kills, {seen.under_way} in a run, {len(seen.wrong)} wrong\n"
    )


def _kill(service: Service, what: str) -> None:
    desk = service.desk()
    if what != "desk":
        service.kill(service.pid)
    if what != "service" and desk is not None:
        service.kill(desk)


async def _same_again(browser: Browser, shown: dict[str, Any] | None, journal: Path, seen: Lives) -> None:
    """Look until the page shows the run and every step that it showed before; note what is not so."""
    run = _under_way(shown)
    if run is None:
        await browser.look_until(lambda: _is_connected(browser.session), orders=False)
        return
    began_s = asyncio.get_running_loop().time()

    def is_back() -> bool:
        now = browser.session
        if not _is_connected(now):
            return False
        assert now is not None
        if now["run"] is None or now["run"]["id"] != run["id"]:
            return _state_of(journal, run["id"]) != "interrupted"  # it had ended when it was killed
        return len(now["run"]["found"]) >= len(run["found"]) or now["run"]["state"] == "ended"

    try:
        await browser.look_until(is_back)
    except TimeoutError:
        seen.wrong.append(f"after {run['found'][-1:]} the page shows {browser.session}")
        return
    seen.longest_s = max(seen.longest_s, asyncio.get_running_loop().time() - began_s)
    now = browser.session
    assert now is not None
    found = now["run"]["found"] if now["run"] is not None and now["run"]["id"] == run["id"] else None
    if found is not None and found[: len(run["found"])] != run["found"]:
        seen.wrong.append(f"{run['found']} became {found}")


def _under_way(session: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the run that a page knew of by its name, and that had not ended."""
    run: dict[str, Any] | None = None if session is None else session["run"]
    return run if run is not None and run["id"] and run["state"] != "ended" else None


def _is_connected(session: dict[str, Any] | None) -> bool:
    return session is not None and bool(session["connection"]["connected"])


def _has_ended(session: dict[str, Any] | None) -> bool:
    return session is not None and session["run"] is not None and session["run"]["state"] == "ended"


def _state_of(journal: Path, run_id: str) -> str:
    with Journal.open(next(journal.glob("*.db"))) as opened:
        return Store(opened).run(run_id).state


def _journal_faults(folder: Path, stored: dict[str, list[tuple[str, Any]]]) -> list[str]:
    """Compare the journal with what it held after the kill before; keep what it holds."""
    wrong = []
    with Journal.open(next(folder.glob("*.db"))) as journal:
        if journal.damage is not None:
            wrong.append(f"the journal is damaged: {journal.damage}")
        now = dict[str, list[tuple[str, Any]]]()
        for event in journal.events():
            if event.kind == Kind.FINDING:
                body = json.loads(event.body)
                now.setdefault(event.run_id, []).append((body["step"], body["value"]))
    for run_id, before in stored.items():
        if now.get(run_id, [])[: len(before)] != before:
            wrong.append(f"{run_id} lost or changed a point")
    for run_id, steps in now.items():
        doubled = [step for step, count in Counter(step for step, _ in steps).items() if count > 1]
        wrong += [f"{run_id}: {step} is there twice" for step in doubled]
    stored.update(now)
    return wrong
