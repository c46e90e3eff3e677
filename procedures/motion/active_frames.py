"""What stays as it is on the controller while a run goes on: tool, user frame, payload, external axes.

A joint target means the same with any tool. But who switches the tool while a run is under way has changed what
hangs at the flange, or is working at this robot: points from before and after do not belong together. Nor do they
where a rail or positioner has moved: the arm, or the work, stands elsewhere with the same joints.
"""

import math
from collections.abc import Iterable

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import find_message, join_messages, make_message
from cellcal.drivers.interfaces import ActiveFrames, ShownExternalAxis
from cellcal.procedures.cell import Cell
from cellcal.procedures.run import ProcedureError

WRITTEN_M = 5e-6  # controllers keep frames as float32 millimetres and degrees
WRITTEN_RAD = 5e-6
PAYLOAD_KG = 1e-3  # what a pendant shows
_NO_FRAME_REPORT = "Whether {what} was changed on the controller during the run: this robot does not tell it."


Change = tuple[str, str]  # a sentence, and what undoes it


class FramesChangedError(ProcedureError):
    """Another tool, user frame or payload is active than before."""

    code = "procedure.frames_changed"


async def check_same_frames(cell: Cell) -> None:
    """Check that the tool, user frame and payload are those that this run began with.

    Raises
    ------
    FramesChangedError
        Something else is active. What was measured before is kept.
    """
    if cell.frames is None:
        return
    now = await cell.frames.active_frames()
    if cell.motion.frames is None:
        cell.motion.frames = now
    changed = frame_changes(cell.motion.frames, now)
    if changed:
        raise FramesChangedError(
            make_message(
                "the robot does not work with what this run began with: {changes_text}",
                changes_text=changes_text(changed),
            ),
            remedy=cure_text(changed),
        )


def refuse_unnamed(named: ActiveFrames, now: ActiveFrames | None) -> None:
    """Hold, before a run begins, that what is active is what the cell file names.

    Raises
    ------
    FramesChangedError
        Something else is active, or the robot does not tell what the file wants to be compared.
    """
    told_now = now or ActiveFrames()
    for what, want, found in (
        ("tool_number", named.tool_number, told_now.tool_number),
        ("user_frame_number", named.user_frame_number, told_now.user_frame_number),
        ("payload_kg", named.payload_kg, told_now.payload_kg),
    ):
        if want is not None and found is None:
            raise FramesChangedError(
                make_message(
                    "the cell file names {what} {want}, and this robot does not tell it", what=what, want=want
                ),
                remedy=make_message(
                    "Take {what} out of [robot.active], and look on the pendant yourself.", what=what
                ),
            )
    changed = frame_changes(named, told_now)
    if changed:
        raise FramesChangedError(
            make_message(
                "the robot does not work with what the cell file names: {changes_text}",
                changes_text=changes_text(changed),
            ),
            remedy=cure_text(changed, "start again"),
        )


def frame_changes(was: ActiveFrames, now: ActiveFrames) -> tuple[Change, ...]:
    """Return each difference as a sentence, and what undoes it. What one of them does not tell is no difference."""
    found = (
        _selection_change("tool", was.tool_number, now.tool_number),
        _tool_change(was, now),
        _selection_change("user frame", was.user_frame_number, now.user_frame_number),
        _payload_change(was.payload_kg, now.payload_kg),
    )
    selected = tuple(change for change in found if change is not None)
    return selected + _external_changes(was.external_axes, now.external_axes)


def changes_text(changed: Iterable[Change]) -> str:
    """Return all differences as one clause."""
    return join_messages("; ", (sentence for sentence, _ in changed))


def cure_text(changed: Iterable[Change], then: str = "resume") -> str:
    """Return what a technician does about the differences."""
    undone = [undo for _, undo in changed]
    only = find_message(undone[0]) if len(undone) == 1 else None
    if only is not None and only.template in _CURES:
        return make_message(_CURES[only.template], **only.arguments, then=then)
    return make_message(
        "Do all of this, then {then}: {undone}.", then=then, undone=join_messages("; ", undone)
    )


def unread_frames(frames: ActiveFrames | None) -> tuple[str, ...]:
    """Return, for a certificate, what this robot could not be asked while the run went on."""
    known_frames = frames or ActiveFrames()
    parts = (
        ("the tool", known_frames.tool_number is None and known_frames.flange_tool is None),
        ("the user frame", known_frames.user_frame_number is None),
        ("the payload", known_frames.payload_kg is None),
    )
    unknown = [what for what, missing in parts if missing]
    return tuple(make_message(_NO_FRAME_REPORT, what=what) for what in unknown)


_SELECTIONS = {  # what is different, and what undoes it
    "tool": ("tool {now} is active, and not tool {was}", "select tool {was} on the pendant again"),
    "user frame": (
        "user frame {now} is active, and not user frame {was}",
        "select user frame {was} on the pendant again",
    ),
}


_CURES = {  # of a single difference: the template that undoes it, and what is said to a person
    "select tool {was} on the pendant again": "Select tool {was} on the pendant again, then {then}.",
    "select user frame {was} on the pendant again": "Select user frame {was} on the pendant again, then {then}.",
    "set {name} to {pose} on the pendant again": "Set {name} to {pose} on the pendant again, then {then}.",
    "set the payload to {was} kg on the pendant again": (
        "Set the payload to {was} kg on the pendant again, then {then}."
    ),
    "drive the external axis {axis} back to {was}": "Drive the external axis {axis} back to {was}, then {then}.",
}


def _selection_change(what: str, was: int | None, now: int | None) -> Change | None:
    if was is None or now is None or was == now:
        return None
    sentence, undo = _SELECTIONS[what]
    return make_message(sentence, now=now, was=was), make_message(undo, was=was)


def _tool_change(was: ActiveFrames, now: ActiveFrames) -> Change | None:
    before, after = was.flange_tool, now.flange_tool
    if before is None or after is None or was.tool_number != now.tool_number or is_same_pose(before, after):
        return None
    name = "the active tool" if was.tool_number is None else f"tool {was.tool_number}"
    pose = _pose_text(before)
    return (
        make_message("{name} is at {now}, and not at {pose}", name=name, now=_pose_text(after), pose=pose),
        make_message("set {name} to {pose} on the pendant again", name=name, pose=pose),
    )


def _payload_change(was: float | None, now: float | None) -> Change | None:
    if was is None or now is None or abs(was - now) <= PAYLOAD_KG:
        return None
    return (
        make_message("the payload is {now:.3f} kg, and not {was:.3f} kg", now=now, was=was),
        make_message("set the payload to {was:.3f} kg on the pendant again", was=was),
    )


def _external_changes(
    was: tuple[ShownExternalAxis, ...] | None, now: tuple[ShownExternalAxis, ...] | None
) -> tuple[Change, ...]:
    """Return which external axes stand elsewhere; one that only one of both has, is none that moved."""
    before = {axis.name: axis.shown for axis in was or ()}
    return tuple(
        (
            make_message(
                "the external axis {axis} stands at {now:.3f}, and not at {was:.3f}",
                axis=axis.name,
                now=axis.shown,
                was=before[axis.name],
            ),
            make_message(
                "drive the external axis {axis} back to {was:.3f}", axis=axis.name, was=before[axis.name]
            ),
        )
        for axis in now or ()
        if axis.name in before and abs(axis.shown - before[axis.name]) > axis.wanders
    )


def _pose_text(pose: Pose) -> str:
    x, y, z = (value * 1e3 for value in pose.position_m)
    w, *turn = pose.quaternion
    turned = ", ".join(f"{value:.5f}" for value in (w, *turn))
    return make_message(
        "x {x:.3f}, y {y:.3f}, z {z:.3f} mm (quaternion {turned})", x=x, y=y, z=z, turned=turned
    )


def is_same_pose(first: Pose, second: Pose) -> bool:
    """Whether two poses are equal as far as a controller can store them."""
    apart_m = math.dist(first.position_m, second.position_m)
    cosine = min(abs(sum(a * b for a, b in zip(first.quaternion, second.quaternion, strict=True))), 1.0)
    chord = math.sqrt(max(2.0 - 2.0 * cosine, 0.0))  # half the angle; acos would lose eight digits here
    return apart_m <= WRITTEN_M and 2.0 * chord <= WRITTEN_RAD
