"""What is drawn over the robot: the frames that runs found, and how surely its tool's tip is known."""

import asyncio
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.stored_results import Kept, all_kept
from cellcal.service.review.review_models import ToolDoubt
from cellcal.service.web.door import Who, house_of
from cellcal.service.web.residuals import solver_of
from cellcal.service.web.response_models import answering

router = APIRouter()
RobotName = Annotated[str, Path(max_length=64)]
_MOST_JOINTS = 12
_SHOWN = {  # what is kept: its kind on the screen, what it is fixed in, and where its pose is
    "tool_frame": ("tool", "flange", "flange_tool"),
    "user_frame": ("user", "base", "read_back"),
    "alignment": ("fixture", "base", "base_fixture"),
}


@dataclass(frozen=True, slots=True)
class FrameSeen:
    """A frame as a run found it; ``fixed_in`` is ``base`` or ``flange``."""

    kind: str  # tool, user, fixture
    name: str
    fixed_in: str
    matrix: tuple[float, ...]  # (4, 4) row by row
    run_id: str
    at_utc: str


@router.get("/models/{robot}/frames")
async def frames(robot: RobotName, request: Request, who: Who) -> list[FrameSeen]:
    """Return the newest tool, user frames and fixtures that runs of this cell found for a robot."""
    del who
    return await asyncio.to_thread(frames_of, house_of(request).config, robot)


@router.get("/models/{robot}/uncertainty", **answering(ToolDoubt, "an ellipsoid about the tip"))
async def uncertainty(
    robot: RobotName, request: Request, who: Who, joints_rad: Annotated[str, Query(max_length=400)]
) -> dict[str, Any]:
    """Return the ellipsoid (k = 2) about the tool's tip at a posture: joints [rad], separated by commas."""
    del who
    house_of(request).config.robot(robot)  # one that is not there is refused before anything is computed
    asked = _joints(joints_rad)
    found: dict[str, Any] = await solver_of(request).ask("tool doubt", robot=robot, joints_rad=asked)
    return found


def _joints(text: str) -> list[float]:
    from cellcal.service.review.review_models import ReviewError  # noqa: PLC0415  # with the answer, not at the start

    try:
        return [float(part) for part in text.split(",")[: _MOST_JOINTS + 1]]
    except ValueError as error:
        raise ReviewError("these are no joints.", remedy="Send numbers, separated by commas.") from error


def frames_of(config: CellConfig, robot: str) -> list[FrameSeen]:
    """Return the newest frame of each kind and name.

    Raises
    ------
    CellError
        There is no such robot in the cell.
    """
    serial = config.robot(robot).serial
    newest: dict[tuple[str, str], Kept] = {}
    for kept in all_kept(config, serial):
        if kept.what in _SHOWN:
            newest.pop((kept.what, kept.subject), None)
            newest[kept.what, kept.subject] = kept
    return [_seen(kept) for kept in newest.values()]


def _seen(kept: Kept) -> FrameSeen:
    kind, fixed_in, key = _SHOWN[kept.what]
    return FrameSeen(kind, kept.subject, fixed_in, _matrix(kept.value[key]), kept.run_id, kept.at_utc)


def _matrix(told: Any) -> tuple[float, ...]:
    from pydantic import TypeAdapter  # noqa: PLC0415  # with the first frame

    from cellcal.calibration.geometry import Pose  # noqa: PLC0415  # heavy, as above

    pose: Pose = TypeAdapter(Pose).validate_python(told)
    return tuple(float(v) for v in pose.matrix().ravel())
