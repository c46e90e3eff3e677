"""Runs that are interrupted at each of their moments: the link is lost, or the process is killed.

The moments are those that a run comes to: a step begins, a person is asked, a person has done it. Each is interrupted
once, one after the other, and the same run goes on until it passes.
"""

import asyncio
import json
import multiprocessing
import os
import signal
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cellcal.calibration.errors import CellError
from cellcal.drivers.interfaces import Answer, GuidesPerson, Instruction, Operator, Question
from cellcal.procedures.progress import StepProgress
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import RunTarget, resume_run, start_run
from tests.machine_speed import stretched_s
from tests.wire.driver_cases import open_retrying

MOST_ENTRIES = 600
SWITCHED_OFF = ("power_cycle", "power cycle", "wait for the robot")
Interruption = Literal["link", "mended link", "kill"]
INTERRUPTIONS: tuple[Interruption, ...] = (
    "link",
    "mended link",
    "kill",
)  # mended: before a step is tried again
_fork = multiprocessing.get_context("fork")


@dataclass(frozen=True)
class InterruptedCase:
    """One run and who stands at the pendant. ``is_needless`` tells of an instruction whose work is done already."""

    cell_file: Path
    fake_client: FakeCellClient
    robot: str
    procedure: str
    settings: Mapping[str, object]
    make_operator: Callable[[FakeCellClient], Operator]
    is_needless: Callable[[Instruction, dict[str, Any]], bool]
    link_faults: tuple[str, ...] = ("refuse", "reset")
    between: tuple[str, ...] = ()  # what happens at the controller before the next entry

    async def read_truth(self) -> dict[str, Any]:
        """Return the truth about the robot."""
        return dict((await self.fake_client.read_truth())["robots"][self.robot])


@dataclass(frozen=True)
class Life:
    """One entry into the run, in a process of its own. What happens goes to a file, which outlives the process."""

    case: InterruptedCase
    log: Path
    interruption: Interruption
    is_first: bool

    def note(self, **fact: Any) -> None:
        """Keep one fact."""
        with self.log.open("a", encoding="utf-8") as opened:
            opened.write(json.dumps(fact) + "\n")

    def facts(self) -> list[dict[str, Any]]:
        """Return what was kept in all lives."""
        lines = self.log.read_text(encoding="utf-8").splitlines() if self.log.exists() else []
        return [json.loads(line) for line in lines]

    def live(self) -> None:
        """Start or resume the run until it ends or is killed."""
        try:
            outcome = asyncio.run(_enter(self))
        except CellError as error:  # refused before the run was entered
            self.note(verdict="refused", code=error.code, reason=error.message, remedy=error.remedy)
        else:
            end = {"code": outcome.code, "reason": outcome.reason, "remedy": outcome.remedy}
            self.note(verdict=outcome.verdict.value, **end, judgement=(outcome.judgement or {}).get("word"))


class InterruptedOperator:
    """An operator whose robot's link, or whose service, goes away at each new moment."""

    def __init__(self, life: Life) -> None:
        self._life, self._inner = life, life.case.make_operator(life.case.fake_client)
        self._known = {fact["moment"] for fact in life.facts() if "moment" in fact}
        self._step, self._is_cut = "", False
        self._coming_back: asyncio.Task[None] | None = None

    async def confirm(self, instruction: Instruction) -> Answer:
        if instruction.key == "retry" and self._life.interruption == "mended link":
            await self._mend_link()
        await self._come_to(f"{self._step}: asked {instruction.key}")
        if self._life.case.is_needless(instruction, await self._life.case.read_truth()):
            self._life.note(needless=f"{self._step}: {instruction.text}")
        answer = await self._inner.confirm(instruction)
        await self._come_to(f"{self._step}: answered {instruction.key}")
        return answer

    async def ask_question(self, question: Question) -> Answer:
        return await self._inner.ask_question(question)

    def show_guidance(self, text: str, values: Mapping[str, Any]) -> None:
        """Show it to who stands at the pendant."""
        if isinstance(self._inner, GuidesPerson):
            self._inner.show_guidance(text, values)

    async def follow(self, steps: "asyncio.Queue[StepProgress]") -> None:
        """Come to each step that begins."""
        while True:
            progress = await steps.get()
            self._step = progress.step
            await self._come_to(f"{progress.step}: begins")

    async def _come_to(self, moment: str) -> None:
        if self._is_cut or moment in self._known:
            return
        self._known.add(moment)
        self._life.note(moment=moment)
        if self._life.interruption == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        self._is_cut = True
        for fault in self._life.case.link_faults:
            await self._life.case.fake_client.inject_fault(fault, device=self._life.case.robot)
        if any(words in moment for words in SWITCHED_OFF):
            self._coming_back = asyncio.create_task(self._mend_soon())

    async def _mend_soon(self) -> None:
        """Let the controller come back: a run waits minutes for one that was switched off."""
        await asyncio.sleep(1.0)
        await self._mend_link()

    async def _mend_link(self) -> None:
        await self._life.case.fake_client.send_command("clear")
        self._is_cut = False


@dataclass
class InterruptedRun:
    """How a run with all its interruptions ended."""

    verdict: str = "never ended"
    judgement: str | None = None
    is_exact: bool = False
    interruptions: int = 0
    entries: int = 0
    ends: Counter[str] = field(default_factory=Counter)  # of entries that ended early
    doubled: list[str] = field(default_factory=list)
    needless: list[str] = field(default_factory=list)
    without_action: list[str] = field(default_factory=list)

    @property
    def is_passed(self) -> bool:
        """Whether it came to its end."""
        return self.verdict == RunVerdict.PASSED


def live_through(
    case: InterruptedCase, log: Path, interruption: Interruption, is_exact: Callable[[dict[str, Any]], bool]
) -> InterruptedRun:
    """Enter a run again and again until it passes."""
    found, facts = InterruptedRun(), list[dict[str, Any]]()
    while not found.is_passed and found.entries < MOST_ENTRIES:
        life = Life(case, log, interruption, is_first=_last_procedure(case) != case.procedure)
        process = _fork.Process(target=life.live)
        process.start()
        process.join(stretched_s(300.0))
        assert process.exitcode in (0, -signal.SIGKILL), process.exitcode
        asyncio.run(_mend(case))
        found.entries, facts = found.entries + 1, life.facts()
        found.verdict = next((fact["verdict"] for fact in facts[::-1] if "verdict" in fact), found.verdict)
    _take_facts(found, facts)
    found.is_exact = is_exact(asyncio.run(case.read_truth()))
    with open_journal(read_cell_file(case.cell_file)) as journal:
        steps = Counter(finding.step for finding in RunStore(journal).list_runs()[-1].past.findings)
    found.doubled = [step for step, count in steps.items() if count > 1]
    return found


def describe_interrupted(name: str, ended: list[InterruptedRun]) -> tuple[str, bool]:
    """Return the figures of a campaign in words, and whether all is as it must be."""
    passed = sum(one.is_passed and one.is_exact for one in ended)
    wrong = sum(one.is_passed and one.judgement == "pass" and not one.is_exact for one in ended)
    doubled = [step for one in ended for step in one.doubled]
    needless = [text for one in ended for text in one.needless]
    without_action = [reason for one in ended for reason in one.without_action]
    line = (
        f"{name}: {wrong} wrong accepts, {passed} of {len(ended)} passed after "
        f"{sum(one.interruptions for one in ended)} interruptions in {sum(one.entries for one in ended)} entries, "
        f"{len(doubled)} steps done twice {doubled[:3]}, {len(needless)} times asked for what was done "
        f"{needless[:3]}, {len(without_action)} ends without a next action {without_action[:3]}"
    )
    return line, passed == len(ended) and not (wrong or doubled or needless or without_action)


def _take_facts(found: InterruptedRun, facts: list[dict[str, Any]]) -> None:
    found.interruptions = sum("moment" in fact for fact in facts)
    found.needless = [fact["needless"] for fact in facts if "needless" in fact]
    ends = [fact for fact in facts if "verdict" in fact]
    found.judgement = ends[-1].get("judgement") if ends else None
    early = [fact for fact in ends if fact["verdict"] != RunVerdict.PASSED]
    found.ends = Counter(f"{fact['code']}: {fact['reason']} {fact['remedy']}" for fact in early)
    found.without_action = [fact["reason"] for fact in early if not (fact["reason"] and fact["remedy"])]


def _last_procedure(case: InterruptedCase) -> str:
    with open_journal(read_cell_file(case.cell_file)) as journal:
        return RunStore(journal).list_runs()[-1].procedure


async def _mend(case: InterruptedCase) -> None:
    await case.fake_client.send_command("clear")
    for event in case.between:
        await case.fake_client.inject_fault(event, device=case.robot)
    async with open_retrying(read_cell_file(case.cell_file).robot_named(case.robot)):
        pass  # it answers again


async def _enter(life: Life) -> RunOutcome:
    steps: asyncio.Queue[StepProgress] = asyncio.Queue()
    operator = InterruptedOperator(life)

    def announce(progress: StepProgress) -> None:
        if progress.kind == "started":
            steps.put_nowait(progress)

    case = life.case
    target = RunTarget(read_cell_file(case.cell_file), operator, case.robot, announce)
    following: Awaitable[None] = asyncio.create_task(operator.follow(steps))
    try:
        if life.is_first:
            return await start_run(target, case.procedure, case.settings)
        return await resume_run(target, "last")
    finally:
        asyncio.ensure_future(following).cancel()
