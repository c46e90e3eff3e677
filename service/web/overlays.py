"""What is drawn over the robot: the frames that runs found, and how surely its tool's tip is known."""

import asyncio
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.stored_results import JournalledResult, list_stored_results
from cellcal.service.review.review_models import TipUncertainty
from cellcal.service.web.dependencies import Who, app_context
from cellcal.service.web.residuals import compute_client_of
from cellcal.service.web.response_models import response_options
from cellcal.service.web.waiting_clients import answer_while_awaited

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
async def list_frames(robot: RobotName, request: Request, who: Who) -> list[FrameSeen]:
    """Return the newest tool, user frames and fixtures that runs of this cell found for a robot."""
    del who
    return await asyncio.to_thread(frames_of, app_context(request).config, robot)


@router.get("/models/{robot}/uncertainty", **response_options(TipUncertainty, "an ellipsoid about the tip"))
async def get_uncertainty(
    robot: RobotName, request: Request, who: Who, joints_rad: Annotated[str, Query(max_length=400)]
) -> dict[str, Any]:
    """Return the ellipsoid (k = 2) about the tool's tip at a posture: joints [rad], separated by commas."""
    del who
    app_context(request).config.robot_named(
        robot
    )  # one that is not there is refused before anything is computed
    joints = _parse_joints(joints_rad)
    found: dict[str, Any] = await answer_while_awaited(
        request, compute_client_of(request).ask_worker("tool doubt", robot=robot, joints_rad=joints)
    )
    return found


def _parse_joints(text: str) -> list[float]:
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
    serial = config.robot_named(robot).serial
    newest: dict[tuple[str, str], JournalledResult] = {}
    for result in list_stored_results(config, serial):
        if result.what in _SHOWN:
            newest.pop((result.what, result.subject), None)
            newest[result.what, result.subject] = result
    return [_frame_of(result) for result in newest.values()]


def _frame_of(result: JournalledResult) -> FrameSeen:
    kind, fixed_in, key = _SHOWN[result.what]
    return FrameSeen(
        kind, result.subject, fixed_in, _flat_matrix(result.value[key]), result.run_id, result.at_utc
    )


def _flat_matrix(raw: Any) -> tuple[float, ...]:
    from pydantic import TypeAdapter  # noqa: PLC0415  # with the first frame

    from cellcal.calibration.geometry import Pose  # noqa: PLC0415  # heavy, as above

    pose: Pose = TypeAdapter(Pose).validate_python(raw)
    return tuple(float(v) for v in pose.to_matrix().ravel())
