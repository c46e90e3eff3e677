"""A simulated cell made like the real one, from tag points of both: its robot, the robot's base, or a workpiece.

Needs no device: the tags are exported by the simulation, the controller and the measuring device. Programs made in
the calibrated simulation fit the real cell. F. S. Cheng, Calibration of Robot Reference Frames for Enhanced Robot
Positioning Accuracy, 2008, section 5.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NewType

from pydantic import Field, TypeAdapter
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.arm.urdf import UrdfArm, bare_urdf, calibrated_urdf, read_urdf
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.identification.parameters import GEOMETRY, OFFSETS
from cellcal.calibration.points.tag_placement import Method, PlacedTags, Sigmas, place_by_tags
from cellcal.calibration.points.tag_points import Pairs, TagPath, paired
from cellcal.calibration.points.tag_robot import LEAST_TAGS, SimulatedRobot, calibrate_simulated_robot
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.canonical import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.entry import Entry, Keepsake, Phase
from cellcal.procedures.forecast import ANSWER_S, Forecast, Knowledge, Prediction
from cellcal.procedures.limits import (
    CHECK,
    FRAME,
    TOOL,
    AccuracyClass,
    CheckLimits,
    FrameLimits,
    chosen,
    told,
)
from cellcal.procedures.past import Finding
from cellcal.procedures.questions import accept
from cellcal.procedures.refit import Refit, values_of
from cellcal.procedures.run import Run
from cellcal.procedures.teaching.simulation_refit import refit_place, refit_robot
from cellcal.procedures.teaching.simulation_verdict import placed_verdict, robot_verdict
from cellcal.procedures.verdict import NOTHING_MEASURED, Verdict

Part = Literal["robot", "base", "workpiece"]
Description = NewType("Description", str)  # the text of a URDF; who types settings names the file

_NAME_IT = "Name a model (`cellcal models`), or give a description."
ASSUMED_SIGMA_M = 0.0003  # of one coordinate of one tag, in a dry run


@dataclass(frozen=True, slots=True)
class SimulationCell:
    """Which part of a simulated cell is made like the real one, and the tags of both."""

    part: Part
    simulated: (
        TagPath  # robot: joints at each tag; base: tags in the robot's base; workpiece: tags of its model
    )
    measured: (
        TagPath  # robot: by the device; base: in the fixture's frame; workpiece: touched, in the robot's base
    )
    model: str = (
        ""  # part robot: of the robots that ship; empty: the cell's own, unless there is a description
    )
    description: Description = Description("")  # part robot: URDF of the simulation's robot
    tip_link: str = ""  # the description's link at the flange
    level: Annotated[int, Field(ge=OFFSETS, le=GEOMETRY)] = OFFSETS  # 1 zero positions, 2 the whole geometry
    method: Method = "least_squares"  # part workpiece
    nominal: Pose | None = None  # where the simulation has it: device, base in fixture, or workpiece in base
    sigma_m: Annotated[float, Field(gt=0, le=0.1)] | None = (
        None  # of a tag's coordinate; None: residuals tell
    )
    sigma_rad: Annotated[float, Field(gt=0, le=0.5)] | None = None  # of a tag's attitude; None: not used
    accuracy_class: AccuracyClass = "B"
    limits: FrameLimits | None = None
    robot_limits: CheckLimits | None = None


@dataclass(frozen=True, slots=True)
class CalibratedRobot:
    """The simulation's robot as the tags have it, and its description."""

    found: SimulatedRobot
    description: str


@dataclass(frozen=True, slots=True)
class CalibratedPart:
    """What was found of one part of the simulated cell."""

    part: Part
    found: CalibratedRobot | PlacedTags


_PAIRS: TypeAdapter[Pairs] = TypeAdapter(Pairs)
_PLACED: TypeAdapter[PlacedTags] = TypeAdapter(PlacedTags)


async def simulation_cell(run: Run, spec: SimulationCell) -> CalibratedPart:
    """Calibrate a part of a simulated cell from tag points, and have the result accepted."""
    pairs = await run.step("pair the tags", pair_tags, spec.simulated, spec.measured, _least(spec))
    found: CalibratedRobot | PlacedTags
    if spec.part == "robot":
        model = await run.step("choose the model", choose_model, spec.model, bool(spec.description))
        found = await run.solve("calibrate the robot", calibrate_robot, spec, model, pairs)
    else:
        found = await run.solve("place the tags", place_part, spec, pairs)
    shown, sha256 = _shown(spec.part, found), sha256_of(to_jsonable_python(found))
    await run.step("accept the result", accept, shown, sha256)
    return CalibratedPart(spec.part, found)


def calibrate(spec: SimulationCell) -> CalibratedPart:
    """Do the same without a cell and without a journal."""
    pairs = paired(spec.simulated, spec.measured, least=_least(spec))
    if spec.part != "robot":
        return CalibratedPart(spec.part, place_part(spec, pairs))
    if not (spec.model or spec.description):
        raise CalibrationError("nothing tells which robot it is.", remedy=_NAME_IT)
    return CalibratedPart(spec.part, calibrate_robot(spec, spec.model, pairs))


async def pair_tags(cell: Cell, simulated: TagPath, measured: TagPath, least: int) -> Pairs:
    """Put the same tags of both paths side by side; a finding, so that the certificate holds what was used."""
    del cell
    return paired(simulated, measured, least=least)


async def choose_model(cell: Cell, model: str, described: bool) -> str:
    """Return the name of the model: as named, or the cell's; empty where a description takes its place."""
    if described or model:
        return "" if described else model
    if cell.model is None:
        raise CalibrationError("nothing tells which robot it is.", remedy=_NAME_IT)
    return cell.model.name


def calibrate_robot(spec: SimulationCell, model: str, pairs: Pairs) -> CalibratedRobot:
    """Find zero positions and tool, and write them into the robot's description."""
    arm = _described(spec)
    found, calibrated = fit_robot(spec, load_model(model) if arm is None else arm.model, pairs)
    text = bare_urdf(calibrated, geometric_joints=True) if arm is None else calibrated_urdf(arm, calibrated)
    return CalibratedRobot(found, text)


def fit_robot(spec: SimulationCell, nominal: RobotModel, pairs: Pairs) -> tuple[SimulatedRobot, RobotModel]:
    """Find zero positions and tool; return the calibrated model, too."""
    return calibrate_simulated_robot(nominal, pairs, level=spec.level, start_guess=spec.nominal)


def _described(spec: SimulationCell) -> UrdfArm | None:
    if not spec.description:
        return None
    if not spec.tip_link:
        raise CalibrationError(
            "the description's link at the flange is not named.", remedy="Set tip_link, such as tool0."
        )
    return read_urdf(spec.description, tip_link=spec.tip_link)


def place_part(spec: SimulationCell, pairs: Pairs) -> PlacedTags:
    """Place the robot's base in the fixture, or the workpiece in the robot's base."""
    method = spec.method if spec.part == "workpiece" else "least_squares"
    sigmas = Sigmas(spec.sigma_m, spec.sigma_rad)
    return place_by_tags(pairs, method, sigmas=sigmas, nominal=spec.nominal)


def _least(spec: SimulationCell) -> int:
    return LEAST_TAGS if spec.part == "robot" else 3


def _shown(part: Part, found: CalibratedRobot | PlacedTags) -> Instruction:
    if isinstance(found, CalibratedRobot):
        robot = found.found
        text = (
            f"Zero positions of {robot.model}: tags that were not fitted are met within "
            f"{robot.before.rmse_m * 1e3:.3f} mm RMS before and {robot.after.rmse_m * 1e3:.3f} mm after."
        )
    else:
        x, y, z = (value * 1e3 for value in found.outer_inner.position_m)
        what = "The robot's base in the fixture" if part == "base" else "The workpiece in the robot's base"
        text = (
            f"{what}: x {x:.3f}, y {y:.3f}, z {z:.3f} mm, within {found.origin.expanded * 1e3:.3f} mm and "
            f"{math.degrees(found.angle.expanded):.4f} degrees (95 %)."
        )
    return Instruction("accept_part", f"{text} Take it over into the simulation?")


def _outline(spec: SimulationCell) -> tuple[Phase, ...]:
    work = (
        (Phase("choose the model"), Phase("calibrate the robot"))
        if spec.part == "robot"
        else (Phase("place the tags"),)
    )
    return (Phase("pair the tags"), *work, Phase("accept the result"))


def _keeps(spec: SimulationCell, result: CalibratedPart) -> Keepsake:
    return Keepsake("simulated_cell", spec.part, result)


def verdict_on_part(spec: SimulationCell, result: CalibratedPart) -> Verdict:
    """Return what a calibrated part may claim."""
    if isinstance(result.found, CalibratedRobot):
        check = chosen(CHECK, spec.accuracy_class, spec.robot_limits)
        tool = TOOL[spec.accuracy_class]
        from_where = told(spec.accuracy_class, spec.robot_limits)
        verdict = robot_verdict(result.found.found, check, tool, from_where)
    else:
        limits = chosen(FRAME, spec.accuracy_class, spec.limits)
        verdict = placed_verdict(result.found, limits, told(spec.accuracy_class, spec.limits), spec.sigma_m)
    return replace(verdict, remarks=(*verdict.remarks, NOTHING_MEASURED))


def _forecast(spec: SimulationCell, known: Knowledge) -> Forecast:
    del known
    pairs = paired(spec.simulated, spec.measured, least=_least(spec))
    count = len(pairs.one)
    if spec.part == "robot":
        return Forecast(
            ANSWER_S, assumed=(f"{count} tags; how surely they tell the zeros is known when they are fitted",)
        )
    sigma_m = spec.sigma_m or ASSUMED_SIGMA_M
    method = spec.method if spec.part == "workpiece" else "least_squares"
    ideal = place_by_tags(Pairs(pairs.one, pairs.one, ()), method, sigmas=Sigmas(sigma_m, spec.sigma_rad))
    origin = {name: limit.origin_m for name, limit in FRAME.items()}
    turn = {name: limit.angle_rad for name, limit in FRAME.items()}
    return Forecast(
        ANSWER_S,
        predictions=(
            Prediction("origin of the frame", ideal.origin.expanded, "m", origin),
            Prediction("turn of the frame", ideal.angle.expanded, "rad", turn),
        ),
        assumed=(f"{count} tags, each coordinate good to {sigma_m * 1e3:.2f} mm (sigma_m)",),
    )


def _refit(spec: SimulationCell, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    pairs = _PAIRS.validate_python(found["pair the tags"])
    if spec.part == "robot":
        arm = _described(spec)
        nominal = load_model(found["choose the model"]) if arm is None else arm.model
        return refit_robot(pairs, lambda fewer: fit_robot(spec, nominal, fewer))
    placed = _PLACED.validate_python(found["place the tags"])
    return refit_place(pairs, placed, spec.sigma_m, lambda fewer: place_part(spec, fewer))


ENTRY = Entry(
    name="simulation_cell",
    title="Simulated cell from tag points",
    version=1,
    procedure=simulation_cell,
    spec_type=SimulationCell,
    needs=(),
    outline=_outline,
    keeps=_keeps,
    verdict=verdict_on_part,
    forecast=_forecast,
    refit=_refit,
)
