"""The sheet for the robot's door: a mastering record on a page of 80 columns, to be printed and kept there."""

import math
import textwrap
from typing import Protocol

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.mastering.counts import MasteringRecord

WIDTH = 80
_AFTER_A_LOSS = (
    "After a loss of position: leave the brakes closed, exchange the encoder batteries, and run `cellcal run "
    "mastering_recovery`. The record itself is in the signed file; this sheet is for reading and comparing. It is "
    "void once a motor, encoder, belt or gear was exchanged or the robot was mastered anew."
)
_ONLY_COUNTS = (
    "This record is from a controller's backup. It holds no lengths and no places: lost turns cannot be found with "
    "it. Run `cellcal run mastering_record` while the robot is healthy. It is void once the robot was mastered anew."
)
_BY_HAND = (
    "Where everything else is lost, the counts at zero are what the controller's mastering data must be, in its own "
    "turns: they may be typed in only while the encoders still count as they did when the record was taken."
)


class SheetRecord(Protocol):
    """The contents of a sheet."""

    @property
    def robot(self) -> str: ...
    @property
    def record(self) -> MasteringRecord: ...
    @property
    def stored_utc(self) -> str: ...
    @property
    def run_id(self) -> str: ...


def as_sheet(sheet_record: SheetRecord, cell: str, public_key: str = "") -> str:
    """Return the sheet as text; with the key, where a signed file goes with it."""
    record = sheet_record.record
    lines = [
        "MASTERING RECORD",
        "=" * WIDTH,
        f"robot           {sheet_record.robot}, serial {record.robot_serial}",
        f"model           {record.model}",
        f"cell            {cell}",
        f"stored (UTC)    {sheet_record.stored_utc[:19].replace('T', ' ')}",
        f"by              {record.taken_by}, run {sheet_record.run_id}",
        f"encoder epoch   {record.epoch if record.is_measured else 'not known'}",
        "",
        *_axis_lines(record),
        "",
        *_length_lines(record),
        "",
        *textwrap.wrap(_AFTER_A_LOSS if record.is_measured else _ONLY_COUNTS, WIDTH),
        "",
        *textwrap.wrap(_BY_HAND, WIDTH),
        "",
        f"record SHA-256  {record.sha256}",
        *([f"signed by       {public_key}"] if public_key else []),
        "",
        "Name ______________________  Date ______________  Signature ____________________",
    ]
    return "\n".join(line[:WIDTH].rstrip() for line in lines) + "\n"


def _length_lines(record: MasteringRecord) -> list[str]:
    wire = record.wire
    if wire is None:
        return ["wire: nothing measured"]
    return [
        f"wire: anchor {_format_mm(wire.anchor_in_base_m)} in the base",
        f"      hook   {_format_mm(wire.hook_in_flange_m)} in the flange",
        f"      {wire.n} lengths, RMS {wire.residual_rms_m * 1e3:.3f} mm about the fit",
    ]


def _axis_lines(record: MasteringRecord) -> list[str]:
    per_turn = np.abs(np.diag(record.drive.radians_per_turn()))
    rows = zip(
        load_model(record.model).joint_names,
        record.counts_at_zero,
        record.reference_counts or ("not told",) * len(per_turn),
        [f"{math.degrees(joint):.4f}" for joint in record.reference_joints_rad]
        or ("not told",) * len(per_turn),
        record.drive.counts_per_turn,
        per_turn,
        strict=True,
    )
    titles = f"{'counts at zero':>16}{'counts here':>16}{'joint here':>13}{'counts/turn':>14}{'deg/turn':>12}"
    return [
        f"{'axis':<6}{titles}",
        *(
            f"{name:<6}{zero:>16}{counts:>16}{joint:>13}{turn:>14}{math.degrees(per):>12.5f}"
            for name, zero, counts, joint, turn, per in rows
        ),
        "'here' is where the robot stood when the record was taken: its reference pose.",
    ]


def _format_mm(place_m: tuple[float, float, float]) -> str:
    x, y, z = (1e3 * value for value in place_m)
    return f"x {x:.1f}, y {y:.1f}, z {z:.1f} mm"
