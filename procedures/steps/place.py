"""Steps that find a place of the recovery kit again: a person brings the tool there, we read where the motors are."""

from typing import Literal

from cellcal.calibration.mastering.counts import PlaceCapture
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Instruction, Joints
from cellcal.procedures.axis_texts import joints_text
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import check_same_frames
from cellcal.procedures.motors import motor_store
from cellcal.procedures.questions import ask_confirmation
from cellcal.procedures.run import ProcedureError
from cellcal.procedures.steps.capture import NotAtRestError
from cellcal.procedures.steps.measure_point import measure_point

PlaceKind = Literal["point", "seat", "target", "nest"]
_WORDS = {
    "point": "Bring the tip to touch point {number} by hand, at creep speed, from above and as it was held before.",
    "seat": "Bring the tool into the keyed seat by hand, at creep speed, until it rests without force.",
    "target": "Bring the arm to about posture {number} of the record, with its target in sight of the instrument.",
    "nest": "Put the target into fixed nest {number}, in sight of the instrument.",
}

_MAKE_TEXTS = {
    "point": "Make the mark where the tip then is, on something that stays.",
    "seat": "Fix the seat there, on something that stays.",
}


class NoContactHereError(ProcedureError):
    """A probe is in the cell, the tip is said to touch, and its contact is open."""

    code = "procedure.no_contact"


async def visit_place(
    cell: Cell,
    what: tuple[PlaceKind, int, str],
    sigma_m: float,
    sigma_rad: float,
    tolerance_counts: int,
    near_rad: Joints | None = None,
) -> PlaceCapture:
    """Have the tool brought to a place and read the motors while everything stands still.

    ``what`` is kind, number and label of the place. ``near_rad`` is the posture that was chosen for it, of a robot
    that knows its position: anything that keeps the tool will do there. Nothing is commanded to move.
    """
    kind, number, label = what
    words = make_message(
        "{format}{near_text} Then let go.",
        format=make_message(_WORDS[kind], number=number + 1),
        near_text=_near_text(cell, kind, near_rad),
    )
    await ask_confirmation(cell, Instruction(f"visit_{kind}_{number + 1}", words))
    store = motor_store(cell)
    before = await store.encoder_counts()
    if kind in ("target", "nest"):
        measured = await measure_point(cell, label)
        after = await store.encoder_counts()
        _refuse_moving(label, before, after, tolerance_counts)
        sigma = max(sigma_m, max(measured.covariance_m2[k][k] for k in range(3)) ** 0.5)
        return PlaceCapture(kind, number, tuple(after), sigma, 0.0, measured.position_m, label)
    await _refuse_open(cell, kind, label)
    await check_same_frames(cell)
    after = await store.encoder_counts()
    _refuse_moving(label, before, after, tolerance_counts)
    return PlaceCapture(
        kind, number, tuple(after), sigma_m, sigma_rad if kind == "seat" else 0.0, None, label
    )


def _near_text(cell: Cell, kind: PlaceKind, near_rad: Joints | None) -> str:
    if near_rad is None or kind == "nest":
        return ""
    words = make_message(
        " The place should be at about {at}, give or take ten.", at=joints_text(cell, near_rad, 0)
    )
    return join_messages(" ", [words, _MAKE_TEXTS[kind]]) if kind in _MAKE_TEXTS else words


async def _refuse_open(cell: Cell, kind: PlaceKind, label: str) -> None:
    """Where a probe is there, its contact must confirm the touch."""
    if kind == "point" and cell.probe is not None and not (await cell.probe.read_contact()).closed:
        raise NoContactHereError(
            make_message("{label}: the probe's contact is open", label=label),
            remedy="Creep on until the probe signals, then confirm again.",
        )


def _refuse_moving(
    label: str, before: tuple[int, ...], after: tuple[int, ...], tolerance_counts: int
) -> None:
    if max(abs(a - b) for a, b in zip(before, after, strict=True)) > tolerance_counts:
        raise NotAtRestError(
            make_message(
                "{label}: counts went from {before} to {after}", label=label, before=before, after=after
            ),
            remedy="Let the arm come to rest, then resume.",
        )
