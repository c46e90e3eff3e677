"""Cures at the pendant whose link is lost at each kind of step, and which are resumed on a mended link.

One run of each brand is interrupted at every moment, one after the other. Nothing wrong may pass, nothing that was
measured is measured again, and the end of each entry says what became of the link.
"""

import asyncio
import tempfile
from pathlib import Path

import numpy as np

from cellcal.drivers.interfaces import Answer, Instruction
from cellcal.procedures.progress import StepProgress
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.launch import RunTarget, resume_run, start_run
from tests.procedures.guided_cures import BRANDS, PendantWorker, guided_fakes
from tests.soak.campaign_figures import CampaignFigures
from tests.wire.driver_cases import open_retrying

MOMENTS = (  # an instruction that is asked or answered, or a step that is under way
    *("asked bring_back", "answered bring_back", "answered near_record_pose"),
    *("go to capture 3", "capture 5", "go to check 1", "check 2"),
)
SETTINGS = {"samples": 1, "first_captures": 8}
MOST_SLIP_RAD = 0.004  # below the limit of a new zero


class CutWorker(PendantWorker):
    """Loses the link at a moment."""

    moment = ""

    async def confirm(self, instruction: Instruction) -> Answer:
        if self.moment.startswith("asked ") and instruction.key.startswith(self.moment[6:]):
            await self.cut()
        answer = await super().confirm(instruction)
        if self.moment.startswith("answered ") and instruction.key.startswith(self.moment[9:]):
            await self.cut()
        return answer

    async def cut(self) -> None:
        """Let the controller refuse every connection."""
        self.moment = ""
        await self.fake_client.inject_fault("refuse", device="robot")
        if self.brand != "yaskawa":  # which has none
            await self.fake_client.inject_fault("reset", device="robot")

    async def follow(self, progress: "asyncio.Queue[StepProgress]") -> None:
        """Cut the link once a step is under way."""
        while True:
            each = await progress.get()
            if each.kind == "started" and each.step == self.moment:
                await self.cut()


def interrupted_cures(seeds: int) -> CampaignFigures:
    """So many cures of each brand: no wrong accept, every run passed, no step done twice."""
    wrong = passed = doubled = uncut = entries = 0
    for brand in BRANDS:
        for seed in range(1, seeds + 1):
            outcomes, error_rad, names = asyncio.run(_play(brand, seed))
            good = outcomes[-1].verdict is RunVerdict.PASSED
            accepted = good and (outcomes[-1].judgement or {}).get("word") == "pass"
            passed += accepted
            wrong += accepted and error_rad > MOST_SLIP_RAD
            doubled += len(names) - len(set(names))
            uncut += len(MOMENTS) - sum(each.code.startswith("device.") for each in outcomes)
            entries += len(outcomes)
    count = seeds * len(BRANDS)
    line = (
        f"interrupted cures: {wrong} wrong accepts, {passed} of {count} passed in {entries} entries, "
        f"{doubled} steps done twice, {uncut} moments without a lost link"
    )
    return CampaignFigures(line, wrong == doubled == uncut == 0 and passed == count)


async def _play(brand: str, seed: int) -> tuple[list[RunOutcome], float, list[str]]:
    rng = np.random.default_rng([seed, BRANDS.index(brand), 356])
    with tempfile.TemporaryDirectory() as folder, guided_fakes(Path(folder), brand, seed) as (path, hands):
        worker = CutWorker(brand, hands.fake_client)
        config = read_cell_file(path)
        record = await start_run(RunTarget(config, worker), "position_record", {"poses": 16, "samples": 1})
        assert record.verdict is RunVerdict.PASSED, record.reason
        lost = tuple(sorted(int(axis) for axis in rng.choice(6, 2, replace=False)))
        worker.slips_rad = {axis: float(rng.uniform(-MOST_SLIP_RAD, MOST_SLIP_RAD)) for axis in lost}
        await worker.lose_position(lost)
        outcomes = [
            await _enter(config, worker, moment, is_first=k == 0) for k, moment in enumerate((*MOMENTS, ""))
        ]
        with open_journal(config) as journal:
            names = [finding.step for finding in RunStore(journal).list_runs()[-1].past.findings]
        return outcomes, float(np.abs((await worker.read_truth())["error_rad"]).max()), names


async def _enter(config: CellConfig, worker: CutWorker, moment: str, *, is_first: bool) -> RunOutcome:
    """Start or resume the cure and lose the link at a moment; mend it afterwards."""
    steps: asyncio.Queue[StepProgress] = asyncio.Queue()
    worker.moment = moment
    following = asyncio.create_task(worker.follow(steps))
    target = RunTarget(config, worker, on_event=steps.put_nowait)
    try:
        if is_first:
            return await start_run(target, "position_cure", SETTINGS)
        return await resume_run(target, "last")
    finally:
        following.cancel()
        await worker.fake_client.send_command("clear")
        async with open_retrying(config.robot_named("robot")):
            pass  # it answers again
