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
from cellcal.calibration.message import make_message
from cellcal.calibration.points.tag_placement import Method, PlacedTags, TagSigmas, place_by_tags
from cellcal.calibration.points.tag_points import TagPairs, TagPath, match_tags
from cellcal.calibration.points.tag_robot import LEAST_TAGS, SimulatedRobot, calibrate_simulated_robot
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.accuracy_limits import (
    CHECK,
    FRAME,
    TOOL,
    AccuracyClass,
    CheckLimits,
    FrameLimits,
    limits_in_force,
    limits_text,
)
from cellcal.procedures.canonical_json import sha256_of
from cellcal.procedures.cell import Cell
from cellcal.procedures.forecast import ANSWER_S, Forecast, Knowledge, Prediction
from cellcal.procedures.procedure_definition import Phase, ProcedureDefinition, StoredResult
from cellcal.procedures.questions import ask_acceptance
from cellcal.procedures.refit import Refit, values_of
from cellcal.procedures.run import Run
from cellcal.procedures.run_history import Finding
from cellcal.procedures.setting_texts import OWN_LIMITS, describe_setting
from cellcal.procedures.teaching.point_remarks import with_remarks
from cellcal.procedures.teaching.simulation_refit import refit_place, refit_robot
from cellcal.procedures.teaching.simulation_verdict import placed_verdict, robot_verdict, tag_remarks
from cellcal.procedures.verdict import NOTHING_MEASURED, ProcedureVerdict

Part = Literal["robot", "base", "workpiece"]
Description = NewType("Description", str)  # the text of a URDF; who types settings names the file

_NAME_IT = "Name a model (`cellcal models`), or give a description."
ASSUMED_SIGMA_M = 0.0003  # of one coordinate of one tag, in a dry run


@dataclass(frozen=True, slots=True)
class SimulationCell:
    """Which part of a simulated cell is made like the real one, and the tags of both."""

    part: Annotated[
        Part,
        describe_setting(
            "What to match",
            "Which part of the simulation is made like the real cell.",
            "what",
            basic=True,
            choices={
                "robot": "the robot",
                "base": "the robot's place on its fixture",
                "workpiece": "the workpiece",
            },
        ),
    ]
    simulated: Annotated[
        TagPath,
        describe_setting(
            "Tags of the simulation",
            "A file with the points as the simulation has them.",
            "place",
            unit="m",
            basic=True,
        ),
    ]
    measured: Annotated[
        TagPath,
        describe_setting(
            "Tags as measured",
            "A file with the same points as they were measured in the real cell.",
            "place",
            unit="m",
            basic=True,
        ),
    ]
    model: Annotated[
        str,
        describe_setting(
            "Robot model",
            "One of the robots that ship; empty: the cell's own, unless a description is given.",
            "tool",
        ),
    ] = ""
    description: Annotated[
        Description, describe_setting("Robot description (URDF)", "File of the simulation's robot.", "tool")
    ] = Description("")
    tip_link: Annotated[
        str,
        describe_setting(
            "Link at the flange", "The name that the description has for the link at the flange.", "tool"
        ),
    ] = ""
    level: Annotated[
        int,
        Field(ge=OFFSETS, le=GEOMETRY),
        describe_setting(
            "What may be wrong with the arm", "1: zeros of the axes; 2: the whole geometry.", "what", unit="1"
        ),
    ] = OFFSETS
    method: Annotated[
        Method,
        describe_setting(
            "How a workpiece is placed",
            "From which points the workpiece's place follows.",
            "what",
            choices={
                "three_points": "three points",
                "six_points": "six points (3-2-1)",
                "least_squares": "all points, best fit",
            },
        ),
    ] = "least_squares"
    nominal: Annotated[
        Pose | None,
        describe_setting(
            "Place in the simulation",
            "Where the simulation has the device, the base or the workpiece.",
            "place",
            unit="m",
            basic=True,
            drawing="frame",
        ),
    ] = None
    sigma_m: Annotated[
        Annotated[float, Field(gt=0, le=0.1)] | None,
        describe_setting(
            "Spread of a tag",
            "Standard deviation of one coordinate; empty: as the remaining errors show.",
            "doubt",
            unit="m",
        ),
    ] = None
    sigma_rad: Annotated[
        Annotated[float, Field(gt=0, le=0.5)] | None,
        describe_setting(
            "Spread of a tag's direction",
            "Standard deviation of an angle; empty: directions are not used.",
            "doubt",
            unit="rad",
        ),
    ] = None
    accuracy_class: Annotated[
        AccuracyClass,
        describe_setting(
            "How good it must be",
            "The class of limits by which the result passes or fails; B is usual.",
            "limits",
            choices={"A": "A: precise", "B": "B: general", "C": "C: coarse"},
        ),
    ] = "B"
    limits: Annotated[FrameLimits | None, OWN_LIMITS] = None
    robot_limits: Annotated[
        CheckLimits | None,
        describe_setting(
            "Own limits of the robot",
            "Figures of your specification for the robot in place of those of the class.",
            "limits",
        ),
    ] = None


@dataclass(frozen=True, slots=True)
class CalibratedRobot:
    """The simulation's robot as the tags have it, and its description."""

    found: SimulatedRobot
    description: str


@dataclass(frozen=True, slots=True)
class CalibratedPart:
    """The result for one part of the simulated cell."""

    part: Part
    found: CalibratedRobot | PlacedTags


_PAIRS: TypeAdapter[TagPairs] = TypeAdapter(TagPairs)
_PLACED: TypeAdapter[PlacedTags] = TypeAdapter(PlacedTags)


async def simulation_cell(run: Run, spec: SimulationCell) -> CalibratedPart:
    """Calibrate a part of a simulated cell from tag points, and have the result accepted."""
    pairs = await run.step("pair the tags", pair_tags, spec.simulated, spec.measured, _least_tags(spec))
    found: CalibratedRobot | PlacedTags
    if spec.part == "robot":
        model = await run.step("choose the model", choose_model, spec.model, bool(spec.description))
        found = await run.solve("calibrate the robot", calibrate_robot, spec, model, pairs)
    else:
        found = await run.solve("place the tags", place_part, spec, pairs)
    shown, sha256 = _result_instruction(spec, found), sha256_of(to_jsonable_python(found))
    await run.step("accept the result", ask_acceptance, shown, sha256)
    return CalibratedPart(spec.part, found)


def calibrate_part(spec: SimulationCell) -> CalibratedPart:
    """Do the same without a cell and without a journal."""
    pairs = match_tags(spec.simulated, spec.measured, least=_least_tags(spec))
    if spec.part != "robot":
        return CalibratedPart(spec.part, place_part(spec, pairs))
    if not (spec.model or spec.description):
        raise CalibrationError("nothing tells which robot it is.", remedy=_NAME_IT)
    return CalibratedPart(spec.part, calibrate_robot(spec, spec.model, pairs))


async def pair_tags(cell: Cell, simulated: TagPath, measured: TagPath, least: int) -> TagPairs:
    """Put the same tags of both paths side by side; a finding, so that the certificate holds what was used."""
    del cell
    return match_tags(simulated, measured, least=least)


async def choose_model(cell: Cell, model: str, described: bool) -> str:
    """Return the name of the model: as named, or the cell's; empty where a description takes its place."""
    if described or model:
        return "" if described else model
    if cell.model is None:
        raise CalibrationError("nothing tells which robot it is.", remedy=_NAME_IT)
    return cell.model.name


def calibrate_robot(spec: SimulationCell, model: str, pairs: TagPairs) -> CalibratedRobot:
    """Find zero positions and tool, and write them into the robot's description."""
    arm = _read_description(spec)
    found, calibrated = fit_robot(spec, load_model(model) if arm is None else arm.model, pairs)
    text = bare_urdf(calibrated, geometric_joints=True) if arm is None else calibrated_urdf(arm, calibrated)
    return CalibratedRobot(found, text)


def fit_robot(
    spec: SimulationCell, nominal: RobotModel, pairs: TagPairs
) -> tuple[SimulatedRobot, RobotModel]:
    """Find zero positions and tool; return the calibrated model, too."""
    return calibrate_simulated_robot(nominal, pairs, level=spec.level, start_guess=spec.nominal)


def _read_description(spec: SimulationCell) -> UrdfArm | None:
    if not spec.description:
        return None
    if not spec.tip_link:
        raise CalibrationError(
            "the description's link at the flange is not named.", remedy="Set tip_link, such as tool0."
        )
    return read_urdf(spec.description, tip_link=spec.tip_link)


def place_part(spec: SimulationCell, pairs: TagPairs) -> PlacedTags:
    """Place the robot's base in the fixture, or the workpiece in the robot's base."""
    method = spec.method if spec.part == "workpiece" else "least_squares"
    sigmas = TagSigmas(spec.sigma_m, spec.sigma_rad)
    return place_by_tags(pairs, method, sigmas=sigmas, nominal=spec.nominal)


def _least_tags(spec: SimulationCell) -> int:
    return LEAST_TAGS if spec.part == "robot" else 3


def _result_instruction(spec: SimulationCell, found: CalibratedRobot | PlacedTags) -> Instruction:
    if isinstance(found, CalibratedRobot):
        robot = found.found
        text = make_message(
            "Zero positions of {model}: tags that were not fitted are met within {rms_before_mm:.3f} mm "
            "RMS before and {rms_after_mm:.3f} mm after.",
            model=robot.model,
            rms_before_mm=robot.before.rmse_m * 1000.0,
            rms_after_mm=robot.after.rmse_m * 1000.0,
        )
    else:
        x, y, z = (value * 1e3 for value in found.outer_inner.position_m)
        what = (
            "The robot's base in the fixture" if spec.part == "base" else "The workpiece in the robot's base"
        )
        text = make_message(
            "{what}: x {x:.3f}, y {y:.3f}, z {z:.3f} mm, within {position_u_mm:.3f} mm and "
            "{angle_u_deg:.4f} degrees (95 %).",
            what=what,
            x=x,
            y=y,
            z=z,
            position_u_mm=found.origin_uncertainty.expanded_uncertainty * 1000.0,
            angle_u_deg=math.degrees(found.angle_uncertainty.expanded_uncertainty),
        )
        text = with_remarks(text, _remarks_on_tags(spec, found))
    return Instruction("accept_part", make_message("{text} Take it over into the simulation?", text=text))


def _outline_phases(spec: SimulationCell) -> tuple[Phase, ...]:
    work = (
        (Phase("choose the model"), Phase("calibrate the robot"))
        if spec.part == "robot"
        else (Phase("place the tags"),)
    )
    return (Phase("pair the tags"), *work, Phase("accept the result"))


def _results_to_store(spec: SimulationCell, result: CalibratedPart) -> StoredResult:
    return StoredResult("simulated_cell", spec.part, result)


def verdict_on_part(spec: SimulationCell, result: CalibratedPart) -> ProcedureVerdict:
    """Return what a calibrated part may claim."""
    if isinstance(result.found, CalibratedRobot):
        check = limits_in_force(CHECK, spec.accuracy_class, spec.robot_limits)
        tool = TOOL[spec.accuracy_class]
        from_where = limits_text(spec.accuracy_class, spec.robot_limits)
        verdict = robot_verdict(result.found.found, check, tool, from_where)
    else:
        limits = limits_in_force(FRAME, spec.accuracy_class, spec.limits)
        verdict = placed_verdict(
            result.found, limits, limits_text(spec.accuracy_class, spec.limits), spec.sigma_m
        )
        verdict = replace(verdict, remarks=(*verdict.remarks, *_remarks_on_tags(spec, result.found)))
    return replace(verdict, remarks=(*verdict.remarks, NOTHING_MEASURED))


def _remarks_on_tags(spec: SimulationCell, found: PlacedTags) -> tuple[str, ...]:
    return tag_remarks(found, match_tags(spec.simulated, spec.measured))


def _forecast_run(spec: SimulationCell, knowledge: Knowledge) -> Forecast:
    del knowledge
    pairs = match_tags(spec.simulated, spec.measured, least=_least_tags(spec))
    count = len(pairs.one)
    if spec.part == "robot":
        return Forecast(
            ANSWER_S,
            assumed=(
                make_message(
                    "{count} tags; how surely they tell the zeros is known when they are fitted", count=count
                ),
            ),
        )
    sigma_m = spec.sigma_m or ASSUMED_SIGMA_M
    method = spec.method if spec.part == "workpiece" else "least_squares"
    ideal = place_by_tags(
        TagPairs(pairs.one, pairs.one, ()), method, sigmas=TagSigmas(sigma_m, spec.sigma_rad)
    )
    origin = {name: limit.origin_m for name, limit in FRAME.items()}
    turn = {name: limit.angle_rad for name, limit in FRAME.items()}
    return Forecast(
        ANSWER_S,
        predictions=(
            Prediction("origin of the frame", ideal.origin_uncertainty.expanded_uncertainty, "m", origin),
            Prediction("turn of the frame", ideal.angle_uncertainty.expanded_uncertainty, "rad", turn),
        ),
        assumed=(
            make_message(
                "{count} tags, each coordinate good to {sigma_mm:.2f} mm (sigma_m)",
                count=count,
                sigma_mm=sigma_m * 1000.0,
            ),
        ),
    )


def _make_refit(spec: SimulationCell, findings: Sequence[Finding]) -> Refit:
    found = values_of(findings)
    pairs = _PAIRS.validate_python(found["pair the tags"])
    if spec.part == "robot":
        arm = _read_description(spec)
        nominal = load_model(found["choose the model"]) if arm is None else arm.model
        return refit_robot(pairs, lambda fewer: fit_robot(spec, nominal, fewer))
    placed = _PLACED.validate_python(found["place the tags"])
    return refit_place(pairs, placed, spec.sigma_m, lambda fewer: place_part(spec, fewer))


DEFINITION = ProcedureDefinition(
    name="simulation_cell",
    title="Simulated cell from tag points",
    version=1,
    procedure=simulation_cell,
    spec_type=SimulationCell,
    needs=(),
    needs_position=False,
    commands_motion=False,
    outline=_outline_phases,
    results_to_store=_results_to_store,
    verdict=verdict_on_part,
    forecast=_forecast_run,
    refit=_make_refit,
)
