"""kill -9 of the service at random instants, in a browser's view: the same step, no point lost or doubled.

A client of the service presses and follows every session; a tab of a real Chromium looks on without a
touches it: after every other restart it is reloaded, else it finds back by itself.
"""

import asyncio
import itertools
import json
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cellcal.procedures.run_history import EventKind
from cellcal.service.record.journal import Journal
from cellcal.service.record.run_store import RunStore
from tests.service.cell_process_session import a_cell
from tests.soak.browser_tab import ShownRun, WatchedTab, open_tab
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.service_process import RECORD, ScriptedBrowser, ServiceProcess, free_port, serve_cell
from tests.stories.catalogue_day import day_stories
from tests.stories.technician_actions import TechnicianActions

LONGEST_LIFE = 70  # sessions that a browser is shown before a kill: a whole record and the start of the next
WHAT = ("service", "desk", "both")  # the web process, the cell's process, or the computer's power
FRAME = next(story for story in day_stories() if story.procedure == "three_point_frame")


@dataclass
class KillObservations:
    """What was seen over many kills."""

    kills: Counter[str] = field(default_factory=Counter)
    points: Counter[str] = field(default_factory=Counter)  # stored ones, by who records them: robot or person
    under_way: int = 0  # kills that hit a run
    compared: int = 0  # times that the tab showed a run before, and the same one after
    reloads: int = 0
    longest_s: float = 0.0  # from the service's being back until the same step was shown again
    wrong: list[str] = field(default_factory=list)


@dataclass
class Observers:
    """Who looks: the program, and the tab; what they were shown before the kill."""

    browser: ScriptedBrowser
    tab: WatchedTab
    session: dict[str, Any] | None = None
    shown: ShownRun = field(default_factory=ShownRun)


def cell_process_kills(kills: int) -> CampaignFigures:
    """Kill the service so often while runs go on, one after the other."""
    with tempfile.TemporaryDirectory() as folder:
        observations = asyncio.run(kill_and_look(Path(folder), kills, seed=5))
    kill_counts = ", ".join(f"{count} of the {what}" for what, count in sorted(observations.kills.items()))
    line = (
        f"cell_process_kills: {kills} kills ({kill_counts}), {observations.under_way} of them in a run; "
        f"{observations.points['robot']} captures and "
        f"{observations.points['person']} points that a person taught are stored; a tab that was "
        f"not touched, reloaded "
        f"{observations.reloads} times, showed the run again {observations.compared} times; "
        f"{len(observations.wrong)} times another step, a "
        f"lost or a doubled point (must be 0) {observations.wrong[:3]}; longest until all was right again "
        f"{observations.longest_s:.1f} s"
    )
    return CampaignFigures(
        line, not observations.wrong and min(observations.under_way, observations.compared) > kills / 2
    )


def _start_orders() -> Iterator[dict[str, Any]]:
    """Points that a person teaches, and captures of the robot's, in turn."""
    return itertools.cycle([{"procedure": FRAME.procedure, "settings": FRAME.settings}, RECORD])


async def kill_and_look(
    folder: Path, kills: int, seed: int, *, longest_life: int = LONGEST_LIFE
) -> KillObservations:
    """Kill and restart; after each kill the pages must show what they showed before."""
    rng, observations, stored = random.Random(seed), KillObservations(), dict[str, list[tuple[str, Any]]]()
    port, starts, eyes = free_port(), _start_orders(), None
    async with AsyncExitStack() as stack:
        path, fake_client = await stack.enter_async_context(a_cell(folder, time_factor=1000.0))
        actions, journal = TechnicianActions(fake_client, FRAME.places), folder / "data"
        while sum(observations.kills.values()) < kills:
            async with serve_cell(path, port) as (service, client):
                browser = ScriptedBrowser(client, starts, actions)
                if eyes is None:
                    eyes = Observers(browser, await stack.enter_async_context(open_tab(journal, port)))
                elif rng.random() < 0.5:
                    await eyes.tab.page.reload()
                    observations.reloads += 1
                eyes.browser = browser
                while sum(observations.kills.values()) < kills:
                    await _same_again(eyes, journal, observations)
                    browser.count = 0
                    life = rng.randrange(1, longest_life)
                    await browser.look_until(lambda b=browser, n=life: b.count >= n)  # type: ignore[misc]
                    await asyncio.sleep(rng.choice((0.0, rng.random() / 4)))
                    what = rng.choice(WHAT)
                    eyes.session, eyes.shown = browser.session, eyes.tab.shown
                    _kill_process(service, what)
                    observations.kills[what] += 1
                    observations.under_way += _under_way(eyes.session) is not None
                    if what != "desk":
                        break
                    browser.session = None
                    await browser.look_until(lambda b=browser: b.session is None, orders=False)  # type: ignore[misc]
                await service.process.wait() if what != "desk" else None
            observations.wrong += _journal_faults(journal, stored)
            _print_progress(observations)
        assert eyes is not None
        async with serve_cell(path, port) as (_, client):
            browser = eyes.browser = ScriptedBrowser(client, starts, actions)
            await _same_again(eyes, journal, observations)
            await browser.look_until(lambda: _has_ended(browser.session))
            assert browser.session is not None
            if browser.session["run"]["outcome"]["verdict"] != "passed":
                observations.wrong.append(f"the last run ended as {browser.session['run']['outcome']}")
        observations.wrong += _journal_faults(journal, stored) + eyes.tab.faults
    for step, _ in itertools.chain(*stored.values()):
        observations.points["robot"] += step.startswith("capture")
        observations.points["person"] += step.startswith("touch")
    return observations


def _print_progress(observations: KillObservations) -> None:
    """Say how far it is: a campaign takes its time."""
    sys.stderr.write(
        f"{sum(observations.kills.values())} kills, {observations.under_way} in a run, "
        f"{len(observations.wrong)} wrong\n"
    )


def _kill_process(service: ServiceProcess, what: str) -> None:
    process_pid = service.cell_process_pid()
    if what != "desk":
        service.kill_process(service.web_pid)
    if what != "service" and process_pid is not None:
        service.kill_process(process_pid)


async def _same_again(eyes: Observers, journal: Path, observations: KillObservations) -> None:
    """Look until both show the run and every point that they showed before; note what is not so."""
    browser, run, began_s = eyes.browser, _under_way(eyes.session), asyncio.get_running_loop().time()
    browser.taught.clear()
    try:
        await browser.look_until(lambda: _tab_is_back(eyes, run), orders=False)
        if run is not None:
            await browser.look_until(lambda: _is_back(eyes, run, journal))
    except TimeoutError:
        observations.wrong.append(
            f"{eyes.shown} became {eyes.tab.shown}; {eyes.session} became {browser.session}"
        )
        return
    if run is None:
        return
    observations.longest_s = max(observations.longest_s, asyncio.get_running_loop().time() - began_s)
    observations.compared += eyes.shown.run == eyes.tab.shown.run == run["id"]
    now = browser.session
    assert now is not None
    found = now["run"]["found"] if now["run"] is not None and now["run"]["id"] == run["id"] else None
    if found is not None and found[: len(run["found"])] != run["found"]:
        observations.wrong.append(f"{run['found']} became {found}")
    question = _open_question(eyes.session)
    open_still = found is not None and question is not None and question["step"] not in found
    if open_still and question is not None and browser.taught[:1] != [question["key"]]:
        observations.wrong.append(f"{question['key']} was asked for before, {browser.taught[:1]} after")


def _tab_is_back(eyes: Observers, run: dict[str, Any] | None) -> bool:
    """Whether the tab has found back by itself and has lost nothing, without a press of any button."""
    session, tab, before = eyes.browser.session, eyes.tab.shown, eyes.shown
    if not (_is_connected(session) and tab.online):
        return False
    assert session is not None
    if run is None or session["run"] is None or session["run"]["id"] != run["id"]:
        return True  # it had ended when it was killed
    return (
        tab.run == run["id"] and bool(tab.lines) and (before.run != tab.run or not tab.missing_lines(before))
    )


def _is_back(eyes: Observers, run: dict[str, Any], journal: Path) -> bool:
    """Whether the run has come to where it was shown before; conditions are agreed to anew on the way."""
    now, tab, question = eyes.browser.session, eyes.tab.shown, _open_question(eyes.session)
    if not _is_connected(now):
        return False
    assert now is not None
    if now["run"] is None or now["run"]["id"] != run["id"]:
        return _state_of(journal, run["id"]) != "interrupted"
    if now["run"]["state"] == "ended":
        return True
    if question is not None and question["step"] not in now["run"]["found"] and not eyes.browser.taught:
        return False
    tab_is = eyes.shown.run != run["id"] or (tab.run == run["id"] and tab.went_on_from(eyes.shown))
    return tab_is and len(now["run"]["found"]) >= len(run["found"])


def _open_question(session: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the question for a point, if one was open."""
    prompt: dict[str, Any] | None = (session or {}).get("prompt")
    return prompt if prompt is not None and prompt["page"] == "teach" else None


def _under_way(session: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the run that a page knew of by its name, and that had not ended."""
    run: dict[str, Any] | None = None if session is None else session["run"]
    return run if run is not None and run["id"] and run["state"] != "ended" else None


def _is_connected(session: dict[str, Any] | None) -> bool:
    return session is not None and bool(session["connection"]["connected"])


def _has_ended(session: dict[str, Any] | None) -> bool:
    return session is not None and session["run"] is not None and session["run"]["state"] == "ended"


def _state_of(journal: Path, run_id: str) -> str:
    with Journal.open_file(next(journal.glob("*.db"))) as opened:
        return RunStore(opened).find_run(run_id).state


def _journal_faults(folder: Path, stored: dict[str, list[tuple[str, Any]]]) -> list[str]:
    """Compare the journal with what it held after the kill before; keep what it holds."""
    wrong = []
    with Journal.open_file(next(folder.glob("*.db"))) as journal:
        if journal.damage is not None:
            wrong.append(f"the journal is damaged: {journal.damage}")
        now = dict[str, list[tuple[str, Any]]]()
        for event in journal.list_events():
            if event.kind == EventKind.FINDING:
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
