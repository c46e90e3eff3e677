"""Campaign over cells without a draw-wire: record by a kit, loss, recovery by that kit; drivers and sockets."""

import asyncio
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.procedures.run import RefusalError
from tests.procedures.test_places_over_the_wire import (
    PROBE,
    TRACKER,
    cell_with,
    lose_position,
    run_procedure_in,
    wrong_rad,
)
from tests.soak.campaign_figures import CampaignFigures

KITS = (("probe", PROBE), ("seat", PROBE), ("tracker", TRACKER))
OUTSIDE = 1.5  # times the stated U: farther off is wrong, not bad luck


def places(seeds: int) -> CampaignFigures:
    """Kits in turn; every fourth loss is an exchanged motor, every ninth a crash: no wrong accept."""
    lines = [
        asyncio.run(_try_seed(seed))
        for seed in track(range(1, seeds + 1), description="places", console=Console(stderr=True))
    ]
    losses = [(good, wrong) for kind, good, wrong in lines if kind != "crash"]
    accepted, wrong = sum(good for good, _ in losses), sum(wrong for *_, wrong in lines)
    crashes = [good for kind, good, _ in lines if kind == "crash"]
    line = (
        f"places: {wrong} wrong accepts; {accepted} of {len(losses)} losses accepted (at least 90 %), "
        f"{sum(crashes)} of {len(crashes)} crashes accepted"
    )
    return CampaignFigures(line, wrong == 0 and accepted >= 0.9 * len(losses) and not any(crashes))


async def _try_seed(seed: int) -> tuple[str, bool, bool]:
    """Return what happened, whether a recovery was accepted, and whether it was wrong."""
    kit, instrument = KITS[seed % len(KITS)]
    fault = "crash" if seed % 9 == 0 else "motor_exchange" if seed % 4 == 0 else "battery_loss"
    fault_settings = {"axis": f"J{1 + seed // 4 % 6}"} if fault == "motor_exchange" else {}
    with tempfile.TemporaryDirectory() as folder:
        async with cell_with(Path(folder), instrument, kit, seed=seed) as (config, cell, fake_client, _):
            recorded = await run_procedure_in(config, cell, "mastering_record")
            last = await cell.mastering.encoder_counts()
            await lose_position(cell, fake_client, fault, **fault_settings)
            if kit == "tracker":
                await fake_client.inject_fault("set_up_again")
            cell_with_record = replace(cell, record=recorded.record)
            try:
                found = await run_procedure_in(
                    config, cell_with_record, "mastering_recovery", last_counts=list(last)
                )
            except RefusalError:
                return fault, False, False
            off = np.abs(await wrong_rad(cell, fake_client))
            # An exact wrist joint has a U too, where the motor it is coupled with was exchanged; else its U is zero.
            allowed = OUTSIDE * np.array([joint.offset_u_rad for joint in found.joints])
            return fault, True, bool((off > allowed + 1e-12).any())
