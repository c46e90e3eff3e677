"""One recovery with a person at the pendant, from a seed: what was lost, where the arm stands, who jogs it."""

import asyncio
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from cellcal.calibration.errors import CellError
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.motion.motion_check import allowed_postures
from cellcal.drivers.interfaces import Counts
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.mastering_recovery import MasteringRecoverySpec, mastering_recovery
from cellcal.procedures.motion.turn_uncertainty import lost_limits
from cellcal.procedures.recovery.pendant_mastering import PendantMastering
from cellcal.procedures.recovery.recovery_result import RecoveryResult
from cellcal.procedures.run import Run
from cellcal.procedures.steps.mastering import read_motors
from tests.procedures.ideal_devices import IdealArm
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.misjudging_technician import MisjudgingTechnician
from tests.procedures.procedure_scenes import ProcedureScene, healthy_scene, record_of


@dataclass(frozen=True, slots=True)
class PendantRecovery:
    """How it ended. ``counts_at_zero`` are what the controller holds."""

    result: RecoveryResult | None
    counts_at_zero: Counts
    true_zero: Counts
    mastered: bool
    guided_s: float
    slips: tuple[str, ...]
    commands: tuple[str, ...]
    reason: str = ""

    @property
    def is_accepted(self) -> bool:
        """Whether it was written and confirmed."""
        return self.result is not None and self.mastered

    @property
    def is_wrong(self) -> bool:
        """Whether the robot is mastered by a zero that is not its own."""
        return self.mastered and self.counts_at_zero != self.true_zero

    @property
    def fitted_captures(self) -> int:
        """The captures that the turns were found from, those measured again among them."""
        return 0 if self.result is None else self.result.captures  # `taken` counts the repeats

    @property
    def all_captures(self) -> int:
        """Those, the checks elsewhere, and the ones after the mastering was written."""
        if self.result is None:
            return 0
        return self.result.captures + self.result.check_captures + self.result.final_captures


async def pendant_scene(seed: int) -> tuple[ProcedureScene, MisjudgingTechnician]:
    """Return a cell without any way to jog or write by wire, its encoders lost somewhere."""
    record: MasteringRecord = await record_of(healthy_scene())
    rng = np.random.default_rng([seed, 26])
    made = healthy_scene()
    made.arm.write_program(await _free_posture(made, record, seed, rng))
    last = await made.arm.encoder_counts()
    made.arm.lose_encoders(tuple(int(k) for k in rng.integers(-3, 4, 6)))
    hands = MisjudgingTechnician(arm=made.arm, seed=seed)
    hands.does["power_cycle"] = made.arm.power_cycle
    made.cell = replace(
        made.cell,
        record=record,
        jogs=None,
        operator=hands,
        mastering=PendantMastering(made.arm, hands),
        level=MotionLevel.OBSERVE,
        limits=replace(made.cell.limits, look_s=0.0),
    )
    made.spec = MasteringRecoverySpec(last_counts=last, samples=2)
    return made, hands


async def _free_posture(
    made: ProcedureScene, record: MasteringRecord, seed: int, rng: np.random.Generator
) -> np.ndarray:
    """Return joints near a pose of the record, as far from everything as half a turn of each motor needs."""
    postures, made.cell = record.capture_joints_rad(), replace(made.cell, record=record)
    state, room = await read_motors(made.cell), MasteringRecoverySpec().room
    limits = lost_limits(state, record, room, (0.5,) * len(postures[0]))
    hook = state.gauge_setup.hook_in_flange_m
    for k in count(seed):
        found = postures[k % len(postures)] + rng.uniform(-0.1, 0.1, 6)
        if allowed_postures(made.arm.model, found[None], limits, hook)[0]:
            return found
    raise AssertionError


async def recover_by_hand(seed: int) -> PendantRecovery:
    """Recover a robot by instructions alone."""
    made, hands = await pendant_scene(seed)
    result, reason = None, ""
    try:
        result = await mastering_recovery(Run(made.cell, MemoryLedger()), made.spec)
    except CellError as error:
        reason = f"{error.code}: {error.message}"
    data = made.arm.data
    return PendantRecovery(
        result,
        data.counts_at_zero,
        _true_zero(made.arm),
        data.mastered,
        hands.guided_s,
        tuple(hands.slips),
        tuple(made.arm.moves),
        reason,
    )


def _true_zero(arm: IdealArm) -> Counts:
    """Return what the encoders count with all joints at zero, the turns that they lost taken off."""
    zeros = zip(arm.true_zero, arm.lost_turns, arm.drive.counts_per_turn, strict=True)
    return tuple(zero - turns * per_turn for zero, turns, per_turn in zeros)


def recover_seed(seed: int) -> PendantRecovery:
    """Recover from outside of an event loop."""
    return asyncio.run(recover_by_hand(seed))
