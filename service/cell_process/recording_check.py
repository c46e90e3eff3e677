"""When a person may record: the arm rests where it is asked for, the wire has come to rest, the point tells.

A page of kind "teach" or "capture" leads straight to a reading. What the reading would be worth is looked at ten
times a second and shown; an answer that comes before it is worth anything is refused here, whatever a page does.
"""

import math
import statistics
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.errors import CellError
from cellcal.drivers.errors import DeviceError
from cellcal.drivers.interfaces import ActiveFrames
from cellcal.procedures.cell import Cell
from cellcal.procedures.motion.active_frames import changes_text, cure_text, frame_changes
from cellcal.procedures.steps.meters import MeterFigure, MeterReading, read_meter
from cellcal.service.cell_process.screen_operator import Prompt
from cellcal.service.session_documents import RecordingDocument, SettleDocument

SETTLE_S = 1.0
SETTLE_SIGMAS = 2.0  # of the gauge: a resting wire scatters by less, a swinging one by more
STALE_S = 1.0
FRAMES_EVERY_S = 0.5
_GAP_S = 0.5  # without a reading for so long, whether the wire rests is unknown
_FRAMES: TypeAdapter[ActiveFrames] = TypeAdapter(ActiveFrames)
_RECORDS = ("teach", "capture")
_GUARDED = (*_RECORDS, "approve", "review")


class NotYetError(CellError):
    """Nothing can be recorded just now; ``code`` says why."""


class SettleDetector:
    """Whether a wire has come to rest: the deviation of a second's readings was small for a second."""

    def __init__(self, limit_m: float) -> None:
        self.limit_m = limit_m
        self.std_m: float | None = None
        self._readings: deque[tuple[float, float]] = deque()
        self._steady_since_s: float | None = None

    def add_reading(self, now_s: float, length_m: float) -> None:
        """Take a reading."""
        if self._readings and now_s - self._readings[-1][0] > _GAP_S:
            self._readings.clear()
            self._steady_since_s = None
        self._readings.append((now_s, length_m))
        while now_s - self._readings[0][0] > SETTLE_S:
            self._readings.popleft()
        values = [length for _, length in self._readings]
        self.std_m = statistics.stdev(values) if len(values) > 1 else None
        is_steady = self.std_m is not None and self.std_m < self.limit_m
        self._steady_since_s = (
            (now_s if self._steady_since_s is None else self._steady_since_s) if is_steady else None
        )

    def is_settled(self, now_s: float) -> bool:
        """Whether it rests, by readings that are fresh."""
        if self._steady_since_s is None or now_s - self._readings[-1][0] > _GAP_S:
            return False
        return now_s - self._steady_since_s >= SETTLE_S

    def as_json(self, now_s: float) -> SettleDocument:
        """Return it for a screen."""
        return {"std_m": self.std_m, "limit_m": self.limit_m, "settled": self.is_settled(now_s)}


@dataclass(slots=True)
class ObservedMotion:
    """The state of robot and wire as the glance saw them last."""

    joints_rad: tuple[float, ...] | None
    moving: bool
    age_s: float  # of the joints
    settled: bool | None  # None where there is no gauge


@dataclass(slots=True)
class RecordingCheck:
    """The obstacles to recording, for the prompt that is open."""

    prompt_id: str = ""
    why: str = ""  # a key for translations; empty: go on
    words: str = ""
    remedy: str = ""
    reading: MeterReading = field(default_factory=MeterReading)
    _frames_at_s: float = float("-inf")
    _changed: tuple[str, str] | None = None

    async def check_prompt(
        self, cell: Cell, prompt: Prompt | None, standing: ObservedMotion, now_s: float
    ) -> None:
        """Look once at what recording now would be worth."""
        if prompt is None or prompt.page not in _GUARDED:
            self._reset_check()
            return
        if prompt.id != self.prompt_id:
            self._reset_check()
            self.prompt_id = prompt.id
        try:
            await self._check_frames(cell, prompt.data, now_s)
            self.reading = await self._read_prompt_meter(cell, prompt.data)
        except DeviceError as error:
            self.why, self.words, self.remedy = "stale", error.message, error.remedy
            return
        self.why, self.words, self.remedy = next(self._find_reasons_against(prompt, standing), ("", "", ""))

    def refuse_early(self, prompt_id: str) -> None:
        """Refuse an answer while something is in the way.

        Raises
        ------
        NotYetError
            Its code is the key that the screen shows.
        """
        if prompt_id == self.prompt_id and self.why:
            words = self.words or "this cannot be recorded just now"
            raise NotYetError(words, code=self.why, remedy=self.remedy)

    def as_json(self) -> RecordingDocument | None:
        """Return it for a screen; None while nothing is recorded."""
        if not self.prompt_id:
            return None
        return {
            "prompt_id": self.prompt_id,
            "ready": not self.why,
            "why": self.why,
            "words": self.words,
            "remedy": self.remedy,
            "warning": self.reading.warning,
            "figures": to_jsonable_python(self.reading.figures),
        }

    def _reset_check(self) -> None:
        self.prompt_id = self.why = self.words = self.remedy = ""
        self.reading, self._changed, self._frames_at_s = MeterReading(), None, float("-inf")

    def _find_reasons_against(
        self, prompt: Prompt, standing: ObservedMotion
    ) -> Iterator[tuple[str, str, str]]:
        """Tell what is in the way, the weightiest first: a key, words, and what to do."""
        if self._changed is not None:
            yield ("context.changed", *self._changed)
        if prompt.page in _RECORDS:
            yield from ((why, "", "") for why in self._find_reasons_against_motion(prompt, standing))
            if self.reading.refusal:
                yield self.reading.refusal, self.reading.words, ""
            if prompt.page == "capture" and standing.settled is False:
                yield "gauge.not_settled", "", ""

    def _find_reasons_against_motion(self, prompt: Prompt, standing: ObservedMotion) -> Iterator[str]:
        if standing.joints_rad is None or standing.age_s > STALE_S:
            yield "stale"
            return
        off = _off_target(prompt.data, standing.joints_rad)
        if off is not None:
            self.reading = replace(self.reading, figures=(*self.reading.figures, off))
            if abs(off.value) > (off.most or 0.0):
                yield "robot.not_there"
        if standing.moving:
            yield "robot.moving"

    async def _read_prompt_meter(self, cell: Cell, data: Mapping[str, Any]) -> MeterReading:
        meter = data.get("meter")
        return MeterReading() if meter is None else read_meter(meter, await cell.robot.flange_pose())

    async def _check_frames(self, cell: Cell, data: Mapping[str, Any], now_s: float) -> None:
        """Compare what is selected on the controller with what the run began with."""
        if cell.frames is None or data.get("frames") is None or now_s - self._frames_at_s < FRAMES_EVERY_S:
            return
        self._frames_at_s = now_s
        was = _FRAMES.validate_python(data["frames"])
        changed = frame_changes(was, await cell.frames.active_frames())
        self._changed = (changes_text(changed), cure_text(changed, "go on here")) if changed else None


def _off_target(data: Mapping[str, Any], joints_rad: tuple[float, ...]) -> MeterFigure | None:
    """Return the joint that is farthest from where it is asked for."""
    target = data.get("target")
    if target is None:
        return None
    errors = [here - there for here, there in zip(joints_rad, target["joints_rad"], strict=True)]
    worst = max(range(len(errors)), key=lambda k: abs(errors[k]))
    if not math.isfinite(errors[worst]):
        return None
    return MeterFigure(f"joint_off:{worst + 1}", errors[worst], "rad", most=target["tolerance_rad"])
