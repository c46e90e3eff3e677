"""Recoveries and cures at the pendant over the wire, with the link lost or the process killed at each moment.

A FANUC whose turns and mastering a person brings back, and an ABB whose revolution counters are updated or whose axes
are calibrated anew. No step is done twice, nothing that is in force is asked for again, and an entry that ends says
why and what to do.
"""

import asyncio
import sys
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cellcal.drivers.interfaces import Instruction, Readiness
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.runs.launch import RunTarget, start_run
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from tests.cell_tables import cell_head, draw_wire_table, fake_table, fanuc_table
from tests.e2e.test_recovery_by_hand import PendantPerson
from tests.procedures.guided_cures import PendantWorker, guided_fakes
from tests.soak.campaign_figures import CampaignFigures
from tests.soak.interrupted_lives import (
    INTERRUPTIONS,
    InterruptedCase,
    InterruptedRun,
    Interruption,
    describe_interrupted,
    live_through,
)
from tests.wire.driver_cases import open_retrying, until_ready
from tests.wire.fake_devices_process import run_fakes

CELL = (
    cell_head("at the pendant")
    + fanuc_table(profile="fanuc_tp", motion="observe")
    + draw_wire_table(deadline_s=3.0, heartbeat_s=2.0)
    + fake_table(time_factor=1000.0, watchdog_factor=10.0)
)
Zero = Literal["kept", "new"]
MOST_SLIP_RAD = 0.004  # below the limit of a new zero


def interrupted_pendant(seeds: int) -> CampaignFigures:
    """So many recoveries of a FANUC for each kind of interruption."""
    ended = [
        _print_run(kind, seed, recover_fanuc(kind, seed))
        for kind in INTERRUPTIONS
        for seed in range(1, seeds + 1)
    ]
    return CampaignFigures(*describe_interrupted("pendant_cut", ended))


def interrupted_abb(seeds: int) -> CampaignFigures:
    """So many cures of an ABB for each kind of interruption, of its revolution counters and of its zeros."""
    zeros: tuple[Zero, ...] = ("kept", "new")
    ended = [
        _print_run(f"{kind}, zero {zero}", seed, cure_abb(kind, zero, seed))
        for kind in INTERRUPTIONS
        for zero in zeros
        for seed in range(1, seeds + 1)
    ]
    return CampaignFigures(*describe_interrupted("abb_cut", ended))


def recover_fanuc(interruption: Interruption, seed: int) -> InterruptedRun:
    """Lose turns, and recover them in as many entries as the interruptions make."""
    text = CELL.replace("seed = 1", f"seed = {seed}")
    with tempfile.TemporaryDirectory() as folder, run_fakes(Path(folder), text) as (path, fake_client):
        marks_rad = asyncio.run(_record_and_lose(path, fake_client))

        def at_pendant(client: FakeCellClient) -> PendantPerson:
            person = PendantPerson(client)
            person.marks_rad = marks_rad
            return person

        case = InterruptedCase(
            path, fake_client, "fanuc", "mastering_recovery", {}, at_pendant, _is_typed_already
        )
        return live_through(case, Path(folder) / "facts.jsonl", interruption, _is_mastered_rightly)


def cure_abb(interruption: Interruption, zero: Zero, seed: int) -> InterruptedRun:
    """Lose counters, and have them updated, or the axes calibrated, in as many entries as the interruptions make."""
    rng = np.random.default_rng([seed, 372])
    with tempfile.TemporaryDirectory() as folder, guided_fakes(Path(folder), "abb", seed) as (path, hands):
        hands.zero = zero
        lost = tuple(sorted(int(axis) for axis in rng.choice(6, 2, replace=False)))
        hands.slips_rad = {axis: float(rng.uniform(-MOST_SLIP_RAD, MOST_SLIP_RAD)) for axis in lost}
        asyncio.run(_record_and_lose_counters(path, hands, lost))

        def at_pendant(client: FakeCellClient) -> PendantWorker:
            return PendantWorker("abb", client, dict(hands.slips_rad), zero=zero)

        settings = {"samples": 1, "first_captures": 8, "zero": zero}
        case = InterruptedCase(
            path, hands.fake_client, "robot", "position_cure", settings, at_pendant, _is_never_needless,
            between=("sessions_expired",),  # each kill leaves one of seventy open, for ten minutes
        )  # fmt: skip
        limit_rad = 1e-6 if zero == "kept" else MOST_SLIP_RAD

        def is_exact(truth: dict[str, Any]) -> bool:
            return float(np.abs(truth["error_rad"]).max()) <= limit_rad

        return live_through(case, Path(folder) / "facts.jsonl", interruption, is_exact)


def _print_run(what: str, seed: int, found: InterruptedRun) -> InterruptedRun:
    sys.stderr.write(f"{what} {seed}: {found}\n")
    return found


def _is_mastered_rightly(truth: dict[str, Any]) -> bool:
    return bool(truth["mastered"] and truth["counts_at_zero"] == truth["true_counts_at_zero"])


def _is_typed_already(instruction: Instruction, truth: dict[str, Any]) -> bool:
    return instruction.key == "type_mastering" and _is_mastered_rightly(truth)


def _is_never_needless(instruction: Instruction, truth: dict[str, Any]) -> bool:
    """Return False: work at a mark whose answer was lost with the process is asked for anew, and does no harm twice."""
    del instruction, truth
    return False


async def _record_and_lose(path: Path, fake_client: FakeCellClient) -> tuple[float, ...]:
    """Record the healthy FANUC, lose its turns; return where its marks are."""
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


async def _record_and_lose_counters(path: Path, hands: PendantWorker, lost: tuple[int, ...]) -> None:
    config = read_cell_file(path)
    outcome = await start_run(RunTarget(config, hands), "position_record", {"poses": 16, "samples": 1})
    assert outcome.verdict is RunVerdict.PASSED, outcome.reason
    await hands.lose_position(lost)
