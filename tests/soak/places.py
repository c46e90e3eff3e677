"""Campaign over cells without a draw-wire: record by a kit, loss, recovery by that kit; drivers and sockets."""

import asyncio
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from cellcal.procedures.run import RefusalError
from tests.procedures.test_places_over_the_wire import PROBE, TRACKER, cell_with, do, lose, wrong_rad
from tests.soak.figures import Figures

KITS = (("probe", PROBE), ("seat", PROBE), ("tracker", TRACKER))
OUTSIDE = 1.5  # times the stated U: farther off is wrong, not bad luck


def places(seeds: int) -> Figures:
    """Kits in turn; every fourth loss is an exchanged motor, every ninth a crash: no wrong accept."""
    told = [
        asyncio.run(_one(seed))
        for seed in track(range(1, seeds + 1), description="places", console=Console(stderr=True))
    ]
    losses = [(good, wrong) for kind, good, wrong in told if kind != "crash"]
    accepted, wrong = sum(good for good, _ in losses), sum(wrong for *_, wrong in told)
    crashes = [good for kind, good, _ in told if kind == "crash"]
    line = (
        f"places: {wrong} wrong accepts; {accepted} of {len(losses)} losses accepted (at least 90 %), "
        f"{sum(crashes)} of {len(crashes)} crashes accepted"
    )
    return Figures(line, wrong == 0 and accepted >= 0.9 * len(losses) and not any(crashes))


async def _one(seed: int) -> tuple[str, bool, bool]:
    """Return what happened, whether a recovery was accepted, and whether it was wrong."""
    kit, instrument = KITS[seed % len(KITS)]
    fault = "crash" if seed % 9 == 0 else "motor_exchange" if seed % 4 == 0 else "battery_loss"
    given = {"axis": f"J{1 + seed // 4 % 6}"} if fault == "motor_exchange" else {}
    with tempfile.TemporaryDirectory() as folder:
        async with cell_with(Path(folder), instrument, kit, seed=seed) as (config, cell, door, _):
            recorded = await do(config, cell, "mastering_record")
            last = await cell.mastering.encoder_counts()
            await lose(cell, door, fault, **given)
            if kit == "tracker":
                await door.fault("set_up_again")
            known = replace(cell, record=recorded.record)
            try:
                found = await do(config, known, "mastering_recovery", last_counts=list(last))
            except RefusalError:
                return fault, False, False
            off = np.abs(await wrong_rad(cell, door))
            # An exact wrist joint has a U too, where the motor it is coupled with was exchanged; else its U is zero.
            allowed = OUTSIDE * np.array([joint.offset_u_rad for joint in found.joints])
            return fault, True, bool((off > allowed + 1e-12).any())
