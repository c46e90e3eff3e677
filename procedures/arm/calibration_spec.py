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
from cellcal.procedures.setting_texts import (
    ACCURACY_CLASS,
    INSTRUMENT,
    OWN_LIMITS,
    RULES,
    TIP_U,
    WRITE_ANYWAY,
    describe_setting,
)
from cellcal.procedures.verdict import SetAside
from cellcal.procedures.write_review import WriteAnyway


@dataclass(frozen=True, slots=True)
class RobotCalibration:
    """With what to measure, what to find, how well it must be known, and how the series is conducted."""

    method: Annotated[Method, INSTRUMENT] = "wire"
    model: Annotated[
        ModelName,
        describe_setting(
            "What may be wrong with the arm",
            "More takes more poses; zeros are what a lost mastering needs.",
            "what",
            basic=True,
            choices={
                "offsets": "zeros of the axes",
                "geometry": "zeros and lengths of the links",
                "sag": "zeros, lengths and bending under weight",
            },
        ),
    ] = "sag"
    tip_u_m: Annotated[Annotated[float, Field(gt=0, le=0.1)] | None, TIP_U] = 0.0004
    offset_sigma_rad: Annotated[
        Annotated[float, Field(gt=0, le=0.1)] | None,
        describe_setting(
            "Certainty of the zeros",
            "The series ends once the zeros are known so well (standard deviation); empty: not asked for.",
            "limits",
            unit="rad",
        ),
    ] = None
    offsets_of: Annotated[
        tuple[str, ...],
        describe_setting("Axes whose zeros count", "Such as J2 offset; empty: all axes.", "limits"),
    ] = ()
    accuracy_class: Annotated[AccuracyClass, ACCURACY_CLASS] = "B"
    limits: Annotated[CheckLimits | None, OWN_LIMITS] = None
    write_zeros: Annotated[
        bool,
        describe_setting(
            "Write the zeros as mastering",
            "Where zeros alone explain the readings they are written to the controller, after your consent.",
            "what",
        ),
    ] = False
    # Of the end-effector, from the tip, measured in between: three for the whole tool frame, one for x, y, z only.
    points_in_tool_m: Annotated[
        tuple[Triple, ...],
        Field(max_length=12),
        describe_setting(
            "Points on the end-effector, from the tip",
            "Where hook or target is fixed, in x, y and z of the tool, by the drawing.",
            "place",
            unit="m",
            drawing="tool",
        ),
    ] = ()
    rough_flange_tool: Annotated[
        Pose | None,
        describe_setting(
            "Tool, roughly",
            "Where the tip is from the flange and how it is turned, by drawing or tape measure.",
            "place",
            unit="m",
            drawing="tool",
        ),
    ] = None
    tool_number: Annotated[
        Annotated[int, Field(ge=0, le=99)] | None,
        describe_setting("Number of the tool to write", "Empty: no tool frame is written.", "what", unit="1"),
    ] = None
    tool_limits: Annotated[
        ToolLimits | None,
        describe_setting(
            "Own limits of the tool",
            "Figures of your specification for the tool in place of those of the class.",
            "limits",
        ),
    ] = None
    write_anyway: Annotated[WriteAnyway, WRITE_ANYWAY] = ""
    rules: Annotated[SeriesRules, RULES] = field(default_factory=SeriesRules)

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
