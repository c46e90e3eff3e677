"""Steps that change a controller: each states a goal, writes only what does not hold yet, reads all back."""

from dataclasses import replace

from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import Counts, MasteringData
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import is_same_pose
from cellcal.procedures.motors import motor_store
from cellcal.procedures.run import NeedsUnmetError, ProcedureError


class ReadBackError(ProcedureError):
    """The controller does not hold what was written."""

    code = "procedure.read_back"


class MasteringChangedError(ProcedureError):
    """The mastering that a run is about to confirm is not in force."""

    code = "procedure.mastering_changed"


async def write_and_read_back(cell: Cell, number: int, flange_tool: Pose) -> Pose:
    """Make tool frame ``number`` be ``flange_tool`` and return what the controller then says."""
    store = cell.tool_frames
    if store is None:
        raise NeedsUnmetError("this robot's tool frames cannot be written", missing=("writes_tool_frame",))
    found = await store.read_tool_frame(number)
    if not is_same_pose(found, flange_tool):
        found = await store.write_tool_frame(number, flange_tool)
    read_back = _check_read_back(f"tool frame {number}", found, flange_tool)
    active = cell.motion.frames
    if active is not None and active.tool_number == number:
        cell.motion.frames = replace(active, flange_tool=read_back)  # our own change is not an outside change
    return read_back


async def read_tool_frame(cell: Cell, number: int) -> Pose:
    """Return the tool frame that the controller holds, before anything is changed."""
    if cell.tool_frames is None:
        raise NeedsUnmetError("this robot's tool frames cannot be read", missing=("writes_tool_frame",))
    return await cell.tool_frames.read_tool_frame(number)


async def read_user_frame(cell: Cell, number: int) -> Pose:
    """Return the user frame that the controller holds, before anything is changed."""
    if cell.user_frames is None:
        raise NeedsUnmetError("this robot's user frames cannot be read", missing=("writes_user_frame",))
    return await cell.user_frames.read_user_frame(number)


async def write_user_frame(cell: Cell, number: int, base_user: Pose) -> Pose:
    """Make user frame ``number`` be ``base_user`` and return what the controller then says."""
    store = cell.user_frames
    if store is None:
        raise NeedsUnmetError("this robot's user frames cannot be written", missing=("writes_user_frame",))
    found = await store.read_user_frame(number)
    if not is_same_pose(found, base_user):
        found = await store.write_user_frame(number, base_user)
    return _check_read_back(f"user frame {number}", found, base_user)


async def write_mastering(cell: Cell, counts_at_zero: Counts) -> MasteringData:
    """Make the controller's mastering be ``counts_at_zero`` and effective; return what it then says."""
    store = motor_store(cell)
    goal = MasteringData(tuple(counts_at_zero), mastered=True)
    found = await store.read_mastering()
    if found != goal:
        await store.write_mastering(goal.counts_at_zero)
        found = await store.read_mastering()
    if found != goal:
        raise ReadBackError(
            make_message(
                "mastering reads {counts_read} after writing {counts_written}",
                counts_read=found.counts_at_zero,
                counts_written=goal.counts_at_zero,
            ),
            remedy="Do not move the robot in AUTO. Restore the old mastering data by hand.",
        )
    return found


async def restore_mastering(cell: Cell, data: MasteringData) -> MasteringData:
    """Put earlier mastering data back, the flag included; return what the controller then says."""
    store = motor_store(cell)
    if await store.read_mastering() != data:
        await store.restore_mastering(data)
    return await store.read_mastering()


async def check_still_in_force(cell: Cell, written: Counts) -> MasteringData:
    """Check that the controller has the mastering that this run wrote, before anything is confirmed by it."""
    found = await motor_store(cell).read_mastering()
    if found != MasteringData(tuple(written), mastered=True):
        raise MasteringChangedError(
            "the controller no longer holds the mastering that this run wrote",
            remedy="Find out who changed it. If the old data are back, resume this run: it writes them anew. Else "
            "start a new run.",
        )
    return found


def _check_read_back(what: str, found: Pose, goal: Pose) -> Pose:
    if not is_same_pose(found, goal):
        raise ReadBackError(
            make_message("{what} reads {found} after writing {goal}", what=what, found=found, goal=goal),
            remedy="Check that the frame is not write-protected.",
        )
    return found
