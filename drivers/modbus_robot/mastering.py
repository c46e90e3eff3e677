"""The controller's mastering data: read, check that they agree with each other, write all or none."""

import math
from collections.abc import Sequence

from cellcal.calibration.mastering.counts import DriveTrain
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import CellError, DeviceError, RefusedError, WireProtocolError
from cellcal.drivers.interfaces import Counts, MasteringData
from cellcal.drivers.modbus_robot.cell_program import CellProgram, ProgramRequest
from cellcal.drivers.modbus_robot.register_client import RegisterClient

_ROUNDING_COUNTS = 0.3  # three float32 factors of a count near 2^19
_RELATIVE = 1e-4


async def read_mastering(panel: RegisterClient) -> MasteringData:
    """Read counts at zero and the mastered flag in one telegram."""
    block = await panel.read_registers("counts_at_zero", "mastered")
    return MasteringData(block.integers_of("counts_at_zero"), block.integer_of("mastered") == 1)


async def read_drive_train(panel: RegisterClient) -> DriveTrain:
    """Learn the drive from the controller: interaction matrix; counts per turn from scale and ratio.

    Raises
    ------
    WireProtocolError
        The three tables contradict each other, so none of them is believed.
    """
    axes = panel.profile.axes
    matrix = (await panel.read_registers("interaction")).numbers_of("interaction")
    block = await panel.read_block("drive")
    scales, ratios = block.numbers_of("counts_per_radian"), block.numbers_of("inverse_ratio")
    rows = tuple(matrix[axes * i : axes * (i + 1)] for i in range(axes))
    turns = [scale * 2 * math.pi * abs(ratio) for scale, ratio in zip(scales, ratios, strict=True)]
    for axis in range(axes):
        whole = abs(turns[axis] - round(turns[axis])) < _ROUNDING_COUNTS and round(turns[axis]) > 0
        same = math.isclose(abs(rows[axis][axis]) * scales[axis], 1.0, rel_tol=_RELATIVE)
        if not (whole and same):
            raise WireProtocolError(
                panel.device,
                make_message(
                    "scale, gear ratio and interaction of axis {axis} contradict each other.", axis=axis + 1
                ),
                remedy="Compare $ENCSCALES, $GEAR_RATIO and $INTERACTION with the data sheet.",
                frame=block.to_hex("counts_per_radian"),
            )
    return DriveTrain(rows, tuple(round(turn) for turn in turns))


async def write_mastering(
    panel: RegisterClient, program: CellProgram, counts_at_zero: Sequence[int], *, within_s: float
) -> MasteringData:
    """Write all axes, make them effective, read back; put the old data back if any of that fails."""
    old = await read_mastering(panel)
    try:
        return await _write_counts(panel, program, tuple(counts_at_zero), within_s)
    except BaseException as error:
        outcome = await _restore_counts(panel, program, old, within_s)
        if isinstance(error, CellError):
            error.message = make_message(
                "{error_message} {outcome}", error_message=error.message, outcome=outcome
            )
        raise


async def restore_mastering(
    panel: RegisterClient, program: CellProgram, data: MasteringData, *, within_s: float
) -> MasteringData:
    """Put earlier data back and read them; the flag is cleared first where the data were not in force."""
    if data.mastered:
        return await write_mastering(panel, program, data.counts_at_zero, within_s=within_s)
    await panel.write_registers({"mastered": (0,)})
    await panel.write_registers({"counts_at_zero": data.counts_at_zero})
    found = await read_mastering(panel)
    if found != data:
        raise RefusedError(
            panel.device,
            "the old mastering data are not back.",
            remedy="Do not move the robot in AUTO. Compare $MASTER_COUN with the record.",
        )
    return found


async def _write_counts(
    panel: RegisterClient, program: CellProgram, counts: Counts, within_s: float
) -> MasteringData:
    await panel.write_registers({"counts_at_zero": counts})
    stored = (await read_mastering(panel)).counts_at_zero
    if stored != counts:
        raise _not_written(panel, stored, counts)
    await program.run_request(ProgramRequest("calibrate", within_s=within_s))
    found = await read_mastering(panel)
    if found.counts_at_zero != counts or not found.mastered:
        raise _not_written(panel, found.counts_at_zero, counts)
    return found


async def _restore_counts(
    panel: RegisterClient, program: CellProgram, old: MasteringData, within_s: float
) -> str:
    try:
        await panel.write_registers({"counts_at_zero": old.counts_at_zero})
        if (await read_mastering(panel)).counts_at_zero != old.counts_at_zero:
            return "The old data could NOT be restored: compare the counts with the record before moving."
        if old.mastered:
            await program.run_request(ProgramRequest("calibrate", within_s=within_s))
    except DeviceError as error:
        return make_message(
            "Whether the old data are back is not known ({reason}): read them back before moving.",
            reason=error.message,
        )
    return "The old data were restored."


def _not_written(panel: RegisterClient, found: Counts, expected: Counts) -> RefusedError:
    axes = [str(i + 1) for i, pair in enumerate(zip(found, expected, strict=True)) if pair[0] != pair[1]]
    what = (
        make_message("axis {axes} was not written", axes=", ".join(axes))
        if axes
        else "the controller did not become mastered"
    )
    return RefusedError(
        panel.device,
        make_message("{what}.", what=what),
        remedy="Check that mastering is not locked on the controller, then write again.",
    )
