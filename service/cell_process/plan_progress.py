"""The poses of the plan that was approved last: which is gone to just now, and at which it was measured already.

Read from the run's own steps, so that a run that goes on after a restart, and any screen, has the same series. A
series is left when a result is looked at, something is written, or another plan is shown.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from cellcal.drivers.interfaces import Joints
from cellcal.procedures.progress import StepProgress
from cellcal.service.session_documents import PlanDocument

SAME_RAD = 1e-6  # a move's end is the very pose of its plan
_DIGITS = 5  # of a radian: a picture shows no less
_LEAVES = ("approve", "review")


@dataclass(slots=True)
class PlanProgress:
    """The progress of a run in its plan."""

    _poses: Sequence[Mapping[str, Any]] = ()
    _goal_rad: Joints | None = None
    _measured: set[int] = field(default_factory=set)

    def record_progress(self, progress: StepProgress) -> None:
        """Note one event of the run."""
        done = progress.kind in ("finding", "replayed")
        page = progress.page
        if not done and progress.kind != "started":
            return
        if progress.does == "write" or (page is not None and page.kind in _LEAVES):
            self._clear_plan()
        if done and page is not None and page.kind == "approve":
            self._poses = page.data.get("plan", {}).get("poses", ())
        if progress.does == "move":
            self._goal_rad = progress.goal_rad
        elif page is not None:
            self._goal_rad = None  # the arm rests during a question: nothing is measured there
        elif done and progress.does == "read":
            self._measured |= {place for place in [self._current_pose_index()] if place is not None}
            self._goal_rad = None

    def as_json(self) -> PlanDocument | None:
        """Return it for a screen; None where no plan is under way."""
        if not self._poses:
            return None
        place = self._current_pose_index()
        elsewhere = self._goal_rad if place is None else None
        return {
            "poses": [
                {"name": pose["name"], "joints_rad": _round_joints(pose["joints_rad"])}
                for pose in self._poses
            ],
            "next": place,
            "elsewhere_rad": None if elsewhere is None else _round_joints(elsewhere),
            "measured": sorted(self._measured),
        }

    def _clear_plan(self) -> None:
        self._poses, self._goal_rad, self._measured = (), None, set()

    def _current_pose_index(self) -> int | None:
        """Return which pose of the plan is gone to; None where it is none of them."""
        goal = self._goal_rad
        if goal is None:
            return None
        return next(
            (k for k, pose in enumerate(self._poses) if _is_same_posture(pose["joints_rad"], goal)), None
        )


def _is_same_posture(one_rad: Sequence[float], other_rad: Sequence[float]) -> bool:
    return all(abs(one - other) <= SAME_RAD for one, other in zip(one_rad, other_rad, strict=True))


def _round_joints(joints_rad: Sequence[float]) -> list[float]:
    return [round(angle, _DIGITS) for angle in joints_rad]
