"""A FANUC recovered at its pendant over the wire, with the link lost or the process killed at each moment.

The moments are those that a run comes to: a step begins, a person is asked, a person has done it. Each is interrupted
once, one after the other, and the same run goes on until it passes. No step is done twice, no mastering that is in
force is typed again, and an entry that ends says why and what to do.
"""

import asyncio
import json
import multiprocessing
import os
import signal
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cellcal.calibration.errors import CellError
from cellcal.drivers.interfaces import Answer, Instruction, Readiness
from cellcal.procedures.progress import StepProgress
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import RunTarget, resume_run, start_run
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from tests.cell_tables import cell_head, draw_wire_table, fake_table, fanuc_table
from tests.e2e.test_recovery_by_hand import PendantPerson
from tests.machine_speed import stretched_s
from tests.soak.campaign_figures import CampaignFigures
from tests.wire.driver_cases import open_retrying, until_ready
from tests.wire.fake_devices_process import run_fakes

CELL = (
    cell_head("at the pendant")
    + fanuc_table(profile="fanuc_tp", motion="observe")
    + draw_wire_table(deadline_s=3.0, heartbeat_s=2.0)
    + fake_table(time_factor=1000.0, watchdog_factor=10.0)
)
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
class RecoveryLife:
    """One entry into the run, in a process of its own. What happens goes to a file, which outlives the process."""

    cell_file: Path
    control: tuple[str, int]
    marks_rad: tuple[float, ...]
    log: Path
    interruption: Interruption
    is_first: bool

    def note(self, **fact: Any) -> None:
        """Keep one fact."""
        with self.log.open("a", encoding="utf-8") as opened:
            opened.write(json.dumps(fact) + "\n")

    def facts(self) -> list[dict[str, Any]]:
        """Return what was kept in all lives."""
        return (
            [json.loads(line) for line in self.log.read_text(encoding="utf-8").splitlines()]
            if self.log.exists()
            else []
        )


class InterruptedPerson(PendantPerson):
    """A person at the pendant of a robot whose link or service goes away at each new moment."""

    def __init__(self, life: RecoveryLife) -> None:
        super().__init__(FakeCellClient(*life.control))
        self.marks_rad, self._life = life.marks_rad, life
        self._known = {fact["moment"] for fact in life.facts() if "moment" in fact}
        self._step, self._is_cut = "", False
        self._coming_back: asyncio.Task[None] | None = None

    async def confirm(self, instruction: Instruction) -> Answer:
        if instruction.key == "retry" and self._life.interruption == "mended link":
            await self._mend_link()
        await self._come_to(f"{self._step}: asked {instruction.key}")
        if instruction.key == "type_mastering":
            await self._look_for_typed_counts()
        answer = await super().confirm(instruction)
        await self._come_to(f"{self._step}: answered {instruction.key}")
        return answer

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
        await self.fake_cell.inject_fault("refuse", device="fanuc")
        await self.fake_cell.inject_fault("reset", device="fanuc")
        if any(words in moment for words in SWITCHED_OFF):
            self._coming_back = asyncio.create_task(self._mend_soon())

    async def _mend_soon(self) -> None:
        """Let the controller come back: a run waits minutes for one that was switched off."""
        await asyncio.sleep(1.0)
        await self._mend_link()

    async def _mend_link(self) -> None:
        await self.fake_cell.send_command("clear")
        self._is_cut = False

    async def _look_for_typed_counts(self) -> None:
        truth = (await self.fake_cell.read_truth())["robots"]["fanuc"]
        if truth["mastered"] and truth["counts_at_zero"] == truth["true_counts_at_zero"]:
            self._life.note(typed_again=True)


@dataclass
class InterruptedRecovery:
    """How a recovery with all its interruptions ended."""

    verdict: str = "never ended"
    is_exact: bool = False
    interruptions: int = 0
    entries: int = 0
    ends: Counter[str] = field(
        default_factory=Counter
    )  # of entries that ended early, with the last one's words
    doubled: list[str] = field(default_factory=list)
    typed_again: int = 0
    without_action: list[str] = field(default_factory=list)


def interrupted_pendant(seeds: int) -> CampaignFigures:
    """So many recoveries for each kind of interruption."""
    ended = [recover_interrupted(kind, seed) for kind in INTERRUPTIONS for seed in range(1, seeds + 1)]
    passed = sum(one.verdict == RunVerdict.PASSED and one.is_exact for one in ended)
    wrong = sum(one.verdict == RunVerdict.PASSED and not one.is_exact for one in ended)
    doubled = [step for one in ended for step in one.doubled]
    without_action = [reason for one in ended for reason in one.without_action]
    typed_again = sum(one.typed_again for one in ended)
    line = (
        f"pendant_cut: {wrong} wrong accepts, {passed} of {len(ended)} passed after "
        f"{sum(one.interruptions for one in ended)} interruptions in {sum(one.entries for one in ended)} entries, "
        f"{len(doubled)} steps done twice {doubled[:3]}, {typed_again} times counts in force typed again, "
        f"{len(without_action)} ends without a next action {without_action[:3]}"
    )
    good = passed == len(ended) and not (wrong or doubled or without_action or typed_again)
    return CampaignFigures(line, good)


def recover_interrupted(
    interruption: Interruption, seed: int, most: int = MOST_ENTRIES
) -> InterruptedRecovery:
    """Lose turns, and recover them in as many entries as the interruptions make."""
    found = InterruptedRecovery()
    text = CELL.replace("seed = 1", f"seed = {seed}")
    with tempfile.TemporaryDirectory() as folder, run_fakes(Path(folder), text) as (path, fake_client):
        marks_rad = asyncio.run(_record_and_lose(path, fake_client))
        control, log = (fake_client.host, fake_client.port), Path(folder) / "facts.jsonl"
        while found.verdict != RunVerdict.PASSED and found.entries < most:
            life = RecoveryLife(path, control, marks_rad, log, interruption, is_first=not _has_run(path))
            process = _fork.Process(target=_live, args=(life,))
            process.start()
            process.join(stretched_s(300.0))
            assert process.exitcode in (0, -signal.SIGKILL), process.exitcode
            found.entries += 1
            asyncio.run(_mend(path, fake_client))
            _take_facts(found, life.facts())
        truth = asyncio.run(fake_client.read_truth())["robots"]["fanuc"]
        found.is_exact = truth["mastered"] and truth["counts_at_zero"] == truth["true_counts_at_zero"]
        with open_journal(read_cell_file(path)) as journal:
            steps = Counter(finding.step for finding in RunStore(journal).list_runs()[-1].past.findings)
        found.doubled = [step for step, count in steps.items() if count > 1]
    sys.stderr.write(f"{interruption} {seed}: {found}\n")
    return found


def _take_facts(found: InterruptedRecovery, facts: list[dict[str, Any]]) -> None:
    found.interruptions = sum("moment" in fact for fact in facts)
    found.typed_again = sum("typed_again" in fact for fact in facts)
    ends = [fact for fact in facts if "verdict" in fact]
    found.verdict = ends[-1]["verdict"] if ends else found.verdict
    early = [fact for fact in ends if fact["verdict"] != RunVerdict.PASSED]
    found.ends = Counter(f"{fact['code']}: {fact['reason']} {fact['remedy']}" for fact in early)
    found.without_action = [fact["reason"] for fact in early if not (fact["reason"] and fact["remedy"])]


async def _record_and_lose(path: Path, fake_client: FakeCellClient) -> tuple[float, ...]:
    """Record the healthy robot, lose its turns; return where its marks are."""
    config, person = read_cell_file(path), PendantPerson(fake_client)
    async with open_retrying(config.robot_named("fanuc")):
        pass
    outcome = await start_run(RunTarget(config, person, "fanuc"), "mastering_record", {})
    assert outcome.verdict is RunVerdict.PASSED, outcome.reason
    async with open_cell(config, person, "fanuc") as cell:
        with open_journal(config) as journal:
            record = (await with_robot_history(cell, journal)).record
        await fake_client.inject_fault("battery_loss", device="fanuc")
        await until_ready(cell.robot, Readiness.POSITION_LOST)
    assert record is not None
    return tuple(record.reference_joints_rad)


def _has_run(path: Path) -> bool:
    with open_journal(read_cell_file(path)) as journal:
        return RunStore(journal).list_runs()[-1].procedure == "mastering_recovery"


async def _mend(path: Path, fake_client: FakeCellClient) -> None:
    await fake_client.send_command("clear")
    async with open_retrying(read_cell_file(path).robot_named("fanuc")):
        pass  # it answers again


def _live(life: RecoveryLife) -> None:
    """Start or resume the recovery until it ends or is killed."""
    try:
        outcome = asyncio.run(_enter(life))
    except CellError as error:  # refused before the run was entered
        life.note(verdict="refused", code=error.code, reason=error.message, remedy=error.remedy)
    else:
        life.note(
            verdict=outcome.verdict.value, code=outcome.code, reason=outcome.reason, remedy=outcome.remedy
        )


async def _enter(life: RecoveryLife) -> RunOutcome:
    steps: asyncio.Queue[StepProgress] = asyncio.Queue()
    person = InterruptedPerson(life)

    def announce(progress: StepProgress) -> None:
        if progress.kind == "started":
            steps.put_nowait(progress)

    target = RunTarget(read_cell_file(life.cell_file), person, "fanuc", announce)
    following = asyncio.create_task(person.follow(steps))
    try:
        if life.is_first:
            return await start_run(target, "mastering_recovery", {})
        return await resume_run(target, "last")
    finally:
        following.cancel()
