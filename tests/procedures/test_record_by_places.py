"""A cell without a draw-wire takes its mastering record: the kit that leaves least open, and a recovery by it."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose
from cellcal.drivers.interfaces import Identity, ProbeCapabilities
from cellcal.procedures.catalogue import CATALOGUE
from cellcal.procedures.cell import Cell, ProbeSetup
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.instruments import instruments_of
from cellcal.procedures.mastering_record import MasteringRecordSpec, mastering_record
from cellcal.procedures.mastering_recovery import MasteringRecoverySpec, mastering_recovery
from cellcal.procedures.procedure_definition import all_missing
from cellcal.procedures.recovery.kit_offers import offers_at
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.procedures.recovery.record_verdict import verdict_on_record
from cellcal.procedures.recovery.recovery_kit import KitSpec
from cellcal.procedures.run import DeclinedError, NeedsUnmetError, RefusalError, Run
from cellcal.procedures.steps.kit_bench import NoSuchKitError, read_kit_bench
from cellcal.procedures.verdict import PASS
from tests.procedures.memory_ledgers import CrashError, MemoryLedger, MortalLedger
from tests.procedures.place_technician import TIP, PlaceTechnician, PlaceTracker
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene

LOST = (2, -1, 3, 1, -2, 1)
SPEC = MasteringRecordSpec(evidence="places")
ENTRY = CATALOGUE["mastering_record"]


class AlwaysTouchingProbe:
    """A probe that touches whenever it is asked: the technician has brought it there."""

    name, closed = "probe", True
    capabilities = ProbeCapabilities(0.0015, 2e-5, 3e-6, 0.006, 0.006, 0.003, 0.2)

    async def identify(self) -> Identity:
        return Identity("ideal", "probe", "P-1", "1.0")

    async def read_contact(self) -> "AlwaysTouchingProbe":
        return self


def without_wire(*, probe: bool = False, tracker: bool = False, tool: bool = True) -> ProcedureScene:
    """Return a healthy cell that never had a draw-wire, and a technician who makes marks where he is told to."""
    made = healthy_scene(SPEC)
    tracker_or_none = PlaceTracker(made.arm) if tracker else None
    PlaceTechnician(made, 20, "any", tracker_or_none).follow_the_words()
    if tool:
        made.arm.tools[made.arm.active_tool] = Pose(TIP)
    made.cell = replace(
        made.cell,
        gauge=None,
        gauge_setup=None,
        tracker=tracker_or_none,
        tracker_setup=replace(made.cell.tracker_setup, target_in_flange_m=TIP) if tracker else None,  # type: ignore[type-var]
        probe=AlwaysTouchingProbe() if probe else None,
        probe_setup=ProbeSetup(TIP) if probe else None,
    )
    made.technician.knows["choose_kit"] = ""
    return made


async def recording_places(kit: str) -> ProcedureScene:
    """Return a healthy cell without a draw-wire that takes its record by this kit."""
    made = without_wire(tracker=True) if kit == "tracker" else without_wire(probe=True)
    made.technician.knows["choose_kit"] = kit
    return made


async def record_places(made: ProcedureScene):  # type: ignore[no-untyped-def]
    return await mastering_record(Run(made.cell, MemoryLedger()), made.spec)


@pytest.mark.parametrize(
    ("kit", "means"), [("probe", {"probe": True}), ("seat", {"probe": True}), ("tracker", {"tracker": True})]
)
async def test_what_a_kit_recorded_gives_the_turns_back(kit: str, means: dict[str, bool]) -> None:
    made = without_wire(**means)
    assert all_missing(ENTRY, made.cell) == ()
    made.technician.knows["choose_kit"] = kit
    result = await record_places(made)
    record = result.record
    assert record.wire is None
    assert record.sha256 == seal_of(record)
    assert verdict_on_record(result).overall_decision is PASS
    made.arm.write_program(np.array([0.2, 0.1, -0.3, 0.4, 0.5, -0.6]))
    made.arm.lose_encoders(LOST)
    made.cell = replace(made.cell, record=record)
    spec = MasteringRecoverySpec()  # the default: a record without lengths has its places only
    found = await mastering_recovery(Run(made.cell, MemoryLedger()), spec)
    assert (found.verdict, found.mode) == ("restored", "turns")
    assert tuple(joint.turns_restored for joint in found.joints) == LOST
    assert made.arm.data.mastered


async def test_every_kit_is_shown_with_its_error_and_the_smallest_is_taken_by_default() -> None:
    made = without_wire(probe=True, tracker=True)
    result = await record_places(made)
    offers = result.offers.offers
    assert {offer.name for offer in offers} == {"probe", "seat", "tracker"}
    worst = [offer.widest_u_rad for offer in offers]
    assert worst == sorted(worst)
    text = made.technician.read["choose_kit"]
    for offer in offers:
        assert offer.words in text
        assert f"{np.rad2deg(offer.outlook.offset_u_rad[5]):.3f}" in text
    assert result.record.kit.tip_in_flange_m == offers[0].spec.tip_in_flange_m
    assert result.kit.outlook.offset_u_rad == pytest.approx(offers[0].outlook.offset_u_rad, rel=0.5)


async def test_an_unknown_tip_is_asked_for_and_nothing_is_recorded() -> None:
    made = without_wire(tool=False)
    with pytest.raises(RefusalError, match="where the tip is") as refused:
        await record_places(made)
    assert refused.value.code == "procedure.no_kit"


async def test_a_name_that_is_no_kit_is_asked_again_and_then_refused() -> None:
    made = without_wire(probe=True)
    made.technician.knows["choose_kit"] = "draw-wire"
    with pytest.raises(NoSuchKitError, match="none of"):
        await record_places(made)
    assert made.technician.instructions.count("choose_kit") == 3


async def test_an_own_kit_is_shown_and_may_be_declined() -> None:
    made = without_wire()
    made.spec = replace(SPEC, kit=KitSpec("point", TIP, places=8, sigma_m=1e-4))
    made.technician.refuses.add("use_kit")
    with pytest.raises(DeclinedError, match="8 marks"):
        await record_places(made)


async def test_a_weak_kit_gets_further_places_and_a_hopeless_one_is_refused_in_time() -> None:
    made = without_wire()
    made.spec = replace(SPEC, kit=KitSpec("point", TIP, places=4, sigma_m=2e-4))
    result = await record_places(made)
    assert len(result.record.kit.places) > 4
    assert result.kit.is_strong
    made = without_wire()
    made.spec = replace(
        SPEC, kit=KitSpec("point", (0.0, 0.0, 0.15), places=9)
    )  # on the last axis: J6 is unseen
    with pytest.raises(RefusalError, match="J6") as refused:
        await record_places(made)
    assert refused.value.code == "procedure.weak_kit"
    assert not any(key.startswith("visit") for key in made.technician.instructions)


async def test_a_sick_robot_is_recorded_by_no_means() -> None:
    made = without_wire(probe=True)
    made.arm.lose_encoders(LOST)
    with pytest.raises(RefusalError, match="not ready or not mastered"):
        await record_places(made)
    assert not any(key.startswith("visit") for key in made.technician.instructions)


async def test_a_crash_at_any_write_loses_no_place_and_asks_for_none_twice() -> None:
    made, ledger = without_wire(), MemoryLedger()
    made.spec = replace(SPEC, kit=KitSpec("point", TIP))
    whole = await mastering_record(Run(made.cell, ledger), made.spec)
    for dies_at in range(3, len(ledger.facts), 5):
        again, facts = without_wire(), list[object]()
        again.spec = made.spec
        with pytest.raises(CrashError):
            await mastering_record(Run(again.cell, MortalLedger(facts, dies_at, stored=True)), again.spec)
        remaining_ledger = MemoryLedger(facts)
        done = [finding.step for finding in remaining_ledger.past().findings]
        again.technician.instructions.clear()
        result = await mastering_record(
            Run(again.cell, remaining_ledger, remaining_ledger.past()), again.spec
        )
        visits = sum(key.startswith("visit") for key in again.technician.instructions)
        assert visits == 9 - sum(step.startswith("place ") for step in done)
        assert len(result.record.kit.places) == len(whole.record.kit.places)


async def test_the_outline_of_a_record_by_places_is_what_runs() -> None:
    made, ledger = without_wire(probe=True), MemoryLedger()
    await mastering_record(Run(made.cell, ledger), made.spec)
    ran = {finding.step.rstrip("0123456789 ") for finding in ledger.past().findings}
    assert ran <= {phase.name for phase in ENTRY.outline(made.spec)}


async def test_the_dry_run_lists_each_kit_and_agrees_with_the_run() -> None:
    made = without_wire(probe=True, tracker=True)
    bench = await read_kit_bench(made.cell)
    knowledge = Knowledge(model=made.cell.model, instruments=instruments_of(made.cell))
    foretold = ENTRY.forecast(SPEC, knowledge)  # type: ignore[misc]
    names = [prediction.name for prediction in foretold.predictions]
    assert len(names) == 3
    assert all("by kit" in name for name in names)
    assert foretold.duration_s > 60.0
    assert len(foretold.poses) == len(offers_at(bench, SPEC.room, None, 1).offers[0].postures_rad)
    assert ENTRY.forecast(SPEC, Knowledge()).poses == ()  # type: ignore[misc]


async def test_a_wire_that_is_not_there_is_named() -> None:
    made = without_wire()
    made.spec = MasteringRecordSpec()
    with pytest.raises(NeedsUnmetError, match="length gauge"):
        await record_places(made)


def test_the_probes_own_figures_are_known_on_paper_too() -> None:
    made = without_wire(probe=True)
    cell: Cell = made.cell
    assert instruments_of(cell).probe_tip_m == TIP
    assert instruments_of(replace(cell, probe=None)).probe_tip_m is None
