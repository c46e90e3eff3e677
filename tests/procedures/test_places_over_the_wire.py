"""A cell without a draw-wire: its record by a kit, its turns lost, its recovery by that kit; drivers and sockets."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Answer, Instruction, Readiness
from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.procedure_definition import all_missing
from cellcal.procedures.run import RefusalError, Run
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.unconfirmed_mastering import UnconfirmedMasteringError
from cellcal.service.runs.open_cell import open_cell, with_robot_history
from cellcal.service.runs.run_preview import dry_run, list_procedures
from cellcal.service.runs.run_procedure import resume_procedure, run_procedure
from cellcal.service.runs.settings import build_spec
from cellcal.service.watching.mastering_comparison import MasteringComparison, journalled_mastering
from tests.cell_tables import (
    cell_head,
    fake_table,
    fanuc_table,
    fill_in,
    touch_probe_table,
    tracker_table,
)
from tests.machine_speed import stretched_s
from tests.procedures.certified_runs import HOW
from tests.procedures.fake_technician import FakeTechnician
from tests.procedures.memory_ledgers import MemoryLedger
from tests.wire.fake_devices_process import run_fakes

TIP_MM = [45.0, 20.0, 150.0]
PROBE = touch_probe_table(
    tip_in_flange_mm=TIP_MM,
    tip_sigma_mm=0.5,
    pretravel_mm=0.02,
    overtravel_mm=6.0,
    silence_ms=500.0,
    poll_ms=6.0,
)
TRACKER = tracker_table(
    name="at",
    port=1700,
    station=1,
    deadline_s=5.0,
    measure_deadline_s=20.0,
    target_in_flange_mm=TIP_MM,
    target_sigma_mm=0.5,
)


def cell_without_wire(instrument: str, *, seed: int = 1) -> str:
    """Return the cell file of a robot with one instrument."""
    world = fake_table(watchdog_factor=10.0, seed=seed, time_factor=600.0)
    return cell_head("no wire") + fanuc_table() + instrument + world


@asynccontextmanager
async def cell_with(folder: Path, instrument: str, kit: str, seed: int = 1) -> AsyncIterator[tuple[Any, ...]]:
    with run_fakes(folder, cell_without_wire(instrument, seed=seed)) as (path, fake_client):
        config, hands = read_cell_file(path), FakeTechnician(fake_client, kit)
        async with open_cell(config, hands) as cell:
            yield config, cell, fake_client, hands


async def run_procedure_in(config: CellConfig, cell: Any, procedure: str, **settings: Any) -> Any:
    spec = build_spec(config, "fanuc", procedure, settings)
    assert spec.evidence == "places"  # the default
    return await CATALOGUE[procedure].procedure(Run(cell, MemoryLedger()), spec)


async def lose_position(
    cell: Any, fake_client: FakeCellClient, fault: str = "battery_loss", **fault_settings: Any
) -> None:
    await fake_client.inject_fault(fault, **fault_settings)
    async with asyncio.timeout(stretched_s(90.0)):
        while (condition := await cell.robot.read_condition()).readiness is not Readiness.POSITION_LOST:
            await asyncio.sleep(0.05)
    assert condition.alarms


async def wrong_rad(cell: Any, fake_client: FakeCellClient) -> np.ndarray:
    truth = (await fake_client.read_truth())["robots"]["fanuc"]
    drive = await cell.mastering.drive_train()
    return drive.to_joints(np.array(truth["counts_at_zero"]), np.array(truth["true_counts_at_zero"]))


@pytest.mark.parametrize(("kit", "instrument"), [("probe", PROBE), ("seat", PROBE), ("tracker", TRACKER)])
async def test_a_record_by_places_brings_every_turn_back(tmp_path: Path, kit: str, instrument: str) -> None:
    async with cell_with(tmp_path, instrument, kit) as (config, cell, fake_client, hands):
        assert all_missing(CATALOGUE["mastering_record"], cell) == ()
        recorded = await run_procedure_in(config, cell, "mastering_record")
        assert recorded.record.wire is None
        assert f"{kit}: " in hands.text["choose_kit"]
        last = await cell.mastering.encoder_counts()
        await lose_position(cell, fake_client)
        if instrument is TRACKER:
            await fake_client.inject_fault("set_up_again")  # a tracker is not left standing for a year
        cell_with_record = replace(cell, record=recorded.record)
        found = await run_procedure_in(config, cell_with_record, "mastering_recovery", last_counts=list(last))
        assert (found.verdict, found.mode) == ("restored", "turns")
        assert any(joint.turns_restored for joint in found.joints)
        assert np.abs(await wrong_rad(cell, fake_client)).max() == 0.0


async def test_a_crash_is_refused_and_an_exchanged_motor_lies_inside_its_uncertainty(tmp_path: Path) -> None:
    async with cell_with(tmp_path, PROBE, "probe", seed=2) as (config, cell, fake_client, _):
        recorded = await run_procedure_in(config, cell, "mastering_record")
        cell_with_record = replace(cell, record=recorded.record)
        last = await cell.mastering.encoder_counts()
        await lose_position(cell, fake_client, "motor_exchange")
        found = await run_procedure_in(config, cell_with_record, "mastering_recovery", last_counts=list(last))
        assert [joint.exact for joint in found.joints] == [True, True, False, True, True, True]
        wrong = np.abs(await wrong_rad(cell, fake_client))
        assert wrong[2] <= found.joints[2].offset_u_rad
        assert wrong[[0, 1, 3, 4, 5]].max() == 0.0
        cell_with_record = replace(cell, record=found.record)
        last = await cell.mastering.encoder_counts()
        before = await cell.mastering.read_mastering()
        await lose_position(cell, fake_client, "crash")
        with pytest.raises(RefusalError, match="nothing was written"):
            await run_procedure_in(config, cell_with_record, "mastering_recovery", last_counts=list(last))
        assert (await cell.mastering.read_mastering()).counts_at_zero == before.counts_at_zero


class LinkCuttingTechnician(FakeTechnician):
    """Hands that pull the robot's cable when they come to a place after the mastering was written."""

    pulls = True

    async def confirm(self, instruction: Instruction) -> Answer:
        written = "accept_mastering" in self.instructions
        if written and self.pulls and instruction.key.startswith("visit_"):
            await self.fake_client.inject_fault("refuse", device="fanuc")
        if self.pulls and instruction.key == "retry":
            raise RefusedError("operator", "no")
        return await super().confirm(instruction)


async def test_a_link_cut_right_after_the_write_is_reported_unambiguously(tmp_path: Path) -> None:
    async with cell_with(tmp_path, PROBE, "probe") as (config, opened, fake_client, _):
        hands = LinkCuttingTechnician(fake_client, "probe")
        cell = replace(opened, operator=hands)
        with open_journal(config) as journal:

            async def start(procedure: str, **settings: Any) -> RunOutcome:
                spec = build_spec(config, "fanuc", procedure, settings)
                return await run_procedure(
                    await with_robot_history(cell, journal), procedure, spec, journal, how=HOW
                )

            assert (await start("mastering_record")).verdict is RunVerdict.PASSED
            last = await cell.mastering.encoder_counts()
            await lose_position(cell, fake_client)
            broken = await start("mastering_recovery", last_counts=list(last))
            assert broken.verdict is RunVerdict.CELL_FAILED
            assert "NOT confirmed" in broken.remedy
            hands.pulls = False
            await fake_client.send_command("clear")
            await _answers_again(cell)
            assert [one.of_run for one in RunStore(journal).list_unconfirmed("F-104711")] == [broken.run_id]
            trouble = await MasteringComparison(journalled_mastering(config, "F-104711")).find_trouble(
                cell.mastering
            )
            assert trouble is not None
            assert trouble[1].of_run == broken.run_id
            with pytest.raises(UnconfirmedMasteringError, match=broken.run_id):
                await start("mastering_record")
            passed = await resume_procedure(
                await with_robot_history(cell, journal), broken.run_id, journal, how=HOW
            )
            assert passed.verdict is RunVerdict.PASSED
            assert RunStore(journal).list_unconfirmed("F-104711") == ()
        assert np.abs(await wrong_rad(cell, fake_client)).max() == 0.0


async def _answers_again(cell: Any) -> None:
    async with asyncio.timeout(stretched_s(90.0)):
        while (await cell.robot.read_condition()).readiness is Readiness.UNREACHABLE:
            await asyncio.sleep(0.05)


def test_the_list_and_the_dry_run_say_that_it_is_possible(tmp_path: Path) -> None:
    text = fill_in(cell_without_wire(PROBE), folder=str(tmp_path), address="127.0.0.9")
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    config = read_cell_file(path)
    listed = {row.name: row.lacks for row in list_procedures(config)}
    assert listed["mastering_record"] == ()
    dry_run_text = dry_run(config, "mastering_record", {})
    assert dry_run_text.lacks == ()
    assert dry_run_text.forecast is not None
    assert {"probe", "seat"} == {
        prediction.name.split("'")[1] for prediction in dry_run_text.forecast.predictions
    }
