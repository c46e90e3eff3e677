"""What a robot's calibration is asked for, and what it found."""

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.drivers.interfaces import MasteringData
from cellcal.procedures.accuracy_limits import TOOL, AccuracyClass, CheckLimits, ToolLimits, limits_in_force
from cellcal.procedures.arm.arm_bench import Bench, Method, Triple
from cellcal.procedures.arm.calibration_plan import ModelName, SeriesGoal
from cellcal.procedures.arm.calibration_result import ArmIdentification
from cellcal.procedures.arm.series_rules import SeriesRules
from cellcal.procedures.arm.tool_plan import ToolGoal
from cellcal.procedures.arm.tool_write import WrittenTool
from cellcal.procedures.verdict import SetAside
from cellcal.procedures.write_review import WriteAnyway


@dataclass(frozen=True, slots=True)
class RobotCalibration:
    """With what to measure, what to find, how well it must be known, and how the series is conducted."""

    method: Method = "wire"
    model: ModelName = "sag"  # offsets | geometry | sag: what may be wrong with the arm
    tip_u_m: Annotated[float, Field(gt=0, le=0.1)] | None = (
        0.0004  # U (k = 2) of the target over the work, RMS
    )
    offset_sigma_rad: Annotated[float, Field(gt=0, le=0.1)] | None = (
        None  # acceptance angular standard deviation
    )
    offsets_of: tuple[str, ...] = ()  # "J2 offset"; none: all of them
    accuracy_class: AccuracyClass = "B"
    limits: CheckLimits | None = None
    write_zeros: bool = False  # as mastering, where zeros alone explain the readings
    # Of the end-effector, from the tip, measured in between: three for the whole tool frame, one for x, y, z only.
    points_in_tool_m: Annotated[tuple[Triple, ...], Field(max_length=12)] = ()
    rough_flange_tool: Pose | None = (
        None  # by drawing or tape measure; with one point its orientation is kept
    )
    tool_number: Annotated[int, Field(ge=0, le=99)] | None = None  # to write it to; none: it is not written
    tool_limits: ToolLimits | None = None
    write_anyway: WriteAnyway = ""  # the tool frame
    rules: SeriesRules = field(default_factory=SeriesRules)

    def series_goal(self) -> SeriesGoal:
        """Return when the series may end."""
        if self.tip_u_m is None and self.offset_sigma_rad is None:
            raise CalibrationError(
                "nothing is asked for: neither tip_u_m nor offset_sigma_rad.",
                remedy="Set one of them.",
                code="usage",
            )
        return SeriesGoal(self.tip_u_m, self.offset_sigma_rad, self.offsets_of, self.model, self._tool_goal())

    def _tool_goal(self) -> ToolGoal | None:
        points, rough, limits = self.points_in_tool_m, self.rough_flange_tool, self.limits_of_tool()
        if not points and self.tool_number is None:
            return None
        if rough is None or not points:
            raise CalibrationError(
                "a tool frame is found by points of the end-effector and roughly known places of them.",
                remedy="Set points_in_tool_m and rough_flange_tool, or leave tool_number out.",
                code="usage",
            )
        return ToolGoal(rough, points, limits.tip_m, limits.orientation_rad, self.rules.point_sigma_m)

    def limits_of_tool(self) -> ToolLimits:
        """Return by what the tool frame is judged."""
        return limits_in_force(TOOL, self.accuracy_class, self.tool_limits)


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """The arm as identified, why the series ended, and what was written."""

    identified: ArmIdentification
    arm: CalibratedArm  # as it holds now; other zeros than ``identified`` has where they were written
    goal_reached: bool
    why_ended: str
    set_aside: tuple[SetAside, ...]
    bench: Bench
    written: MasteringData | None = None
    final_rms_m: float | None = None  # at poses gone to again after the zeros were written
    moved_m: float | None = None  # the first pose, measured again at the end
    tool: WrittenTool | None = None
    tool_not_written: str = ""  # why, where it was to be
