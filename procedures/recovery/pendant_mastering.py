"""The mastering of a controller that lets nothing but its pendant write it: a person types it, and it is read back.

A FANUC takes its six counts in the data entry of Master/Cal, and RES_PCA there; no program and no wire writes them.
"""

import contextlib

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Counts, Instruction, MasteringData, Operator, ReadsMastering
from cellcal.procedures.instruction_page import PagedInstruction, with_page

TRIES = 5
RESET_ALARMS = Instruction(
    "reset_alarms_by_hand",
    "On the pendant, acknowledge the lost position (FANUC: RES_PCA in the menu Master/Cal), then press RESET.",
)
CLEAR_MASTERED = Instruction(
    "clear_mastered_by_hand",
    "This robot was not mastered before. On the pendant, take its mastering out of force again (FANUC: set "
    "$DMR_GRP[1].$MASTER_DONE to FALSE).",
)


class PendantMastering:
    """MasteringStore whose writes are made by a person at the pendant. A value typed wrongly is named."""

    def __init__(self, robot: ReadsMastering, operator: Operator) -> None:
        self._robot, self._operator = robot, operator

    async def encoder_counts(self) -> Counts:
        return await self._robot.encoder_counts()

    async def drive_train(self) -> DriveTrain:
        return await self._robot.drive_train()

    async def encoder_epoch(self) -> int:
        return await self._robot.encoder_epoch()

    async def read_mastering(self) -> MasteringData:
        return await self._robot.read_mastering()

    async def write_mastering(self, counts_at_zero: Counts) -> MasteringData:
        return await self._have_typed(tuple(counts_at_zero))

    async def restore_mastering(self, data: MasteringData) -> MasteringData:
        found = await self._robot.read_mastering()
        if found.counts_at_zero != data.counts_at_zero:
            found = await self._have_typed(data.counts_at_zero)
        if found.mastered and not data.mastered:
            await self._operator.confirm(CLEAR_MASTERED)
            found = await self._robot.read_mastering()
        return found

    async def reset_position_alarms(self) -> None:
        await self._operator.confirm(RESET_ALARMS)

    async def _have_typed(self, goal: Counts) -> MasteringData:
        """Ask for the counts until the controller holds them and is mastered by them.

        Raises
        ------
        RefusedError
            It does not hold them after several tries. A robot that was not mastered before is asked to be left so:
            counts that are typed wrongly are a mastering all the same.
        """
        before = found = await self._robot.read_mastering()
        wrong_text = ""
        for _ in range(TRIES):
            await self._operator.confirm(_typing_page(goal, found.counts_at_zero, wrong_text))
            found = await self._robot.read_mastering()
            if found == MasteringData(goal, mastered=True):
                return found
            wrong_text = _wrong_text(goal, found)
        if found.mastered and not before.mastered:
            with contextlib.suppress(RefusedError):  # what was typed wrongly says more than a no to this
                await self._operator.confirm(CLEAR_MASTERED)
        raise RefusedError(
            self._robot.name,
            make_message("the mastering was not typed as asked: {wrong_text}", wrong_text=wrong_text.strip()),
            remedy="Do not move the robot in AUTO. Type the counts of the table, then resume.",
        )


def _typing_page(goal: Counts, found: Counts, wrong_text: str) -> PagedInstruction:
    counts = ", ".join(f"J{axis} {count}" for axis, count in enumerate(goal, 1))
    words = Instruction(
        "type_mastering",
        make_message(
            "{wrong_text}On the pendant, type the master counts {counts}. Make them effective "
            "(FANUC: MASTER_DONE to TRUE, then CALIBRATE in the menu Master/Cal). They are "
            "read back.",
            wrong_text=wrong_text,
            counts=counts,
        ),
    )
    rows = [
        {"name": f"J{axis}", "now": now, "type": count}
        for axis, (now, count) in enumerate(zip(found, goal, strict=True), 1)
    ]
    return with_page(words, "ask", typed_counts=rows)


def _wrong_text(goal: Counts, found: MasteringData) -> str:
    wrong = [
        make_message("J{axis} reads {now}, not {count}", axis=axis, now=now, count=count)
        for axis, (now, count) in enumerate(zip(found.counts_at_zero, goal, strict=True), 1)
        if now != count
    ]
    if wrong:
        return make_message("The controller holds something else: {wrong}. ", wrong=", ".join(wrong))
    return "The counts are right, and the controller is not mastered by them yet. "
