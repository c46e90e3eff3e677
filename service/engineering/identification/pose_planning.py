"""The use case behind ``cellcal poses``: candidates, choice, prediction, order of travel. Prints nothing."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_kinds import joint_columns_of, shown_units
from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.arm.urdf import read_urdf
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.csv_text import parse_rows
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.identifiability import NotIdentified
from cellcal.calibration.identification.observations import Observations, with_mounting
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.work_parts import SERIAL, PartRunner
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.cell_shapes import assumed_shape
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.description_collision import DescriptionCheck
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.poses.enough_poses import AcceptanceLimits, enough_poses
from cellcal.calibration.poses.measurement_poses import (
    DesignCriterion,
    PosePlan,
    choose_poses,
    measurable_postures,
    plan_efficiency,
)
from cellcal.calibration.poses.measurement_prediction import (
    AccuracyPrediction,
    DesignInstrument,
    MeasurementPrediction,
    TestPoses,
    predict_accuracy,
    predict_after_fit,
    predict_from_poses,
)
from cellcal.service.configuration.cell_shapes import read_cell_shape
from cellcal.service.csv_writing import write_rows
from cellcal.service.engineering.identification.at_points import joint_columns_in, read_joint_rows
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.measured.table import MeasurementError

Place = tuple[float, float, float]
_TEST_POSES = 200
_RANDOM_PLANS = 20
_SAME_FLANGE_M = 0.02


class PlanError(CellError):
    """The request cannot be understood; the user can mend it."""

    code = "usage"


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """A URDF whose collision shapes are those of the arm."""

    path: Path
    tip_link: str
    mesh_folders: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """The request for a plan; SI."""

    robot: str
    instrument: DesignInstrument
    tool_in_flange_m: Place = (0.0, 0.0, 0.0)
    wire_range_m: float | None = None
    poses: int = 30
    acceptance: AcceptanceLimits | None = None  # given: as few poses as it needs, at most ``poses``
    criterion: DesignCriterion | None = None
    level: int = GEOMETRY
    drop_redundant: bool = False
    candidates: int = 1000
    seed: int = 1
    after: Path | None = None
    tests: Path | None = None
    shape: Path | None = None
    description: RobotDescription | None = None


@dataclass(frozen=True, eq=False)
class PlanReport:
    """A plan, what it promises, and what was not checked."""

    request: PlanRequest
    plan: PosePlan | None  # None: the acceptance is not reachable
    reason: str  # about the acceptance; empty without one
    prediction: AccuracyPrediction
    not_identified: tuple[NotIdentified, ...]
    before: AccuracyPrediction
    random: AccuracyPrediction | None  # the median of as many poses drawn at random
    efficiency: float | None
    order: tuple[int, ...]  # of the plan's rows, for short ways
    ways_free: tuple[
        bool, ...
    ]  # of the way to each pose in that order from the one before; the first is unknown
    candidates: int
    not_checked: tuple[str, ...] = field(default=())
    shown: tuple[Array, tuple[str, ...]] = field(kw_only=True)  # factors to degrees and mm, columns of joints

    def as_document(self) -> dict[str, object]:
        """Return the object that ``--json`` prints."""
        plan, shown = self.plan, self.shown[0]
        poses = np.zeros((0, len(shown))) if plan is None else plan.joints_rad[list(self.order)] * shown
        return {
            "robot": self.request.robot,
            "reachable": self.plan is not None,
            "reason": self.reason,
            "criterion": None if self.plan is None else str(self.plan.criterion),
            "poses_deg": poses.tolist(),
            "joint_columns": list(self.shown[1]),
            "ranks": [rank + 1 for rank in self.order],
            "ways_free": list(self.ways_free),
            "prediction": asdict(self.prediction),
            "not_identified": [asdict(item) for item in self.not_identified],
            "before": asdict(self.before),
            "random": None if self.random is None else asdict(self.random),
            "efficiency": self.efficiency,
            "candidates": self.candidates,
            "not_checked": list(self.not_checked),
        }


def plan_poses(request: PlanRequest, runner: PartRunner = SERIAL) -> PlanReport:
    """Plan measurement poses, and predict what they will tell; the runner shows what is being done.

    It also carries out the parts of the identification of earlier measurements.

    Raises
    ------
    CellError
        A file or a number of the request is wrong, or no posture is left.
    """
    if not 1 <= request.poses <= request.candidates:
        raise PlanError(f"{request.poses} poses cannot be chosen from {request.candidates} candidates.")
    model = load_model(request.robot)
    prediction = _prediction_basis(request, model, runner)
    runner.show_stage("drawing postures that can be measured")
    limits, check = MotionLimits(wire=_wire_path(request)), _collision_check(request, model)
    described = _description_check(request, model, check)
    filters = (check.is_free,) if described is None else (check.is_free, described.is_free)
    tip = request.tool_in_flange_m
    drawn = measurable_postures(
        model, limits, request.candidates, tip_in_flange_m=tip, filters=filters, seed=request.seed
    )
    tests = TestPoses(_test_joints(request, model, check))
    before = predict_accuracy(prediction, tests)
    runner.show_stage("choosing poses")
    plan, accuracy, reason, after = _choose_poses(request, prediction, drawn, tests)
    runner.show_stage("comparing them with the best that any choice could be")
    order: tuple[int, ...] = ()
    free: tuple[bool, ...] = ()
    if plan is not None and len(plan.indices):
        order = visiting_order(model, plan.joints_rad)
        free = (True, *(bool(way) for way in check.is_path_free(plan.joints_rad[list(order)])))
    return PlanReport(
        request,
        plan,
        reason,
        accuracy,
        after.not_identified(),
        before,
        _predict_random(prediction, drawn, tests, plan),
        plan_efficiency(prediction, drawn, plan, tests) if order and plan is not None else None,
        order,
        free,
        len(drawn),
        _not_checked(check, described),
        shown=(shown_units(model)[0], joint_columns_of(model)),
    )


def visiting_order(model: RobotModel, joints_rad: Array) -> tuple[int, ...]:
    """Return an order with short ways: the next pose is the one that the slowest joint reaches soonest."""
    remaining = list(range(len(joints_rad)))
    order = [remaining.pop(0)]
    while remaining:
        times = np.abs(joints_rad[remaining] - joints_rad[order[-1]]) / model.max_speed_rad_s
        order.append(remaining.pop(int(np.argmin(times.max(axis=1)))))
    return tuple(order)


def write_plan(path: Path, report: PlanReport) -> None:
    """Write the poses as CSV in the order of travel; the file must not exist."""
    if report.plan is None:
        raise PlanError("there is no plan to write.")
    joints = report.plan.joints_rad * report.shown[0]
    with path.open("x", newline="", encoding="utf-8") as file:
        write_rows(file, [[*report.shown[1], "rank", "way_checked"]])
        for rank, free in zip(report.order, report.ways_free, strict=True):
            row = [*(f"{v:.4f}" for v in joints[rank]), rank + 1, "free" if free else "blocked"]
            write_rows(file, [row])


def read_joints(path: Path, arm: RobotModel | int) -> Array:
    """Read joints from CSV with columns q1_deg, q2_mm (of a slide) …; others are ignored. Returns (T, n) [rad, m]."""
    names = joint_columns_in(arm)[0]
    try:
        rows = parse_rows(read_plain_text(path))
    except (OSError, DocumentError) as broken:
        raise PlanError(describe_unreadable(path, broken)) from broken
    if not rows:
        raise PlanError(make_message("{path} holds no rows.", path=path), remedy="Write one posture a row.")
    if not set(names) <= rows[0].keys():
        raise PlanError(f"{path} needs numbers in the columns {', '.join(names)}.")
    try:
        return read_joint_rows(path, rows, arm)
    except MeasurementError as broken:
        raise PlanError(broken.message, remedy=broken.remedy) from broken


def _prediction_basis(request: PlanRequest, model: RobotModel, runner: PartRunner) -> MeasurementPrediction:
    if request.after is None:
        return predict_from_poses(
            model,
            request.instrument,
            tool_in_flange_m=request.tool_in_flange_m,
            level=request.level,
            drop_redundant=request.drop_redundant,
        )
    found = identify_file(request.after, request.robot, IdentifyOptions(level=request.level), runner)
    fit = found.identification.robust.fit
    if fit.layout.kind != request.instrument.kind:
        raise PlanError(
            f"{request.after} holds {fit.layout.kind}s, the plan is for {request.instrument.kind}s."
        )
    last = len(fit.state.devices) - 1

    def simulate_readings(joints_rad: Array) -> Observations:
        observations = request.instrument.make_observations(joints_rad)
        return with_mounting(observations, np.full(len(joints_rad), last, dtype=np.intp))

    return predict_after_fit(fit, simulate_readings)


def _wire_path(request: PlanRequest) -> WirePath | None:
    if request.instrument.kind != "length":
        return None
    if request.wire_range_m is None:
        raise PlanError("the range of the wire is not given.", remedy="Give --wire-range-mm.")
    anchor = request.instrument.anchor_in_base_m
    return WirePath(anchor, request.tool_in_flange_m, request.wire_range_m)


def _collision_check(request: PlanRequest, model: RobotModel) -> CollisionCheck:
    tip, wire = request.tool_in_flange_m, _wire_path(request)
    if request.shape is None:
        shape = assumed_shape(model, tip_in_flange_m=tip, wire=wire)
    else:
        shape = read_cell_shape(request.shape, model, tip_in_flange_m=tip, wire=wire)
    return CollisionCheck.from_model(model, shape)


def _description_check(
    request: PlanRequest, model: RobotModel, check: CollisionCheck
) -> DescriptionCheck | None:
    if request.description is None:
        return None
    description = request.description
    try:
        arm = read_urdf(read_plain_text(description.path), tip_link=description.tip_link)
    except (OSError, DocumentError) as broken:
        raise PlanError(describe_unreadable(description.path, broken)) from broken
    coupling = model.joint_coupling
    plain = np.allclose(coupling, np.diag(np.diag(coupling)))
    matrix = np.eye(model.axis_count) if plain else coupling
    _same_arm(model, arm.model, matrix)
    return DescriptionCheck.from_description(
        arm, check.shape.obstacles, mesh_folders=description.mesh_folders, joint_matrix=matrix,
        margin_m=check.shape.margin_m,
    )  # fmt: skip


def _same_arm(model: RobotModel, described: RobotModel, matrix: Array) -> None:
    joints = np.random.default_rng(0).uniform(-1, 1, (20, model.axis_count))
    if described.axis_count == model.axis_count:
        apart = model.base_flange(joints) - described.base_flange(joints @ matrix.T)
        if np.abs(apart[:, :3, 3]).max() < _SAME_FLANGE_M:
            return
    raise PlanError(
        f"the description does not move its flange as {model.label} does.",
        remedy="Name the link at the flange; its root must be the robot's base.",
    )


def _not_checked(check: CollisionCheck, described: DescriptionCheck | None) -> tuple[str, ...]:
    if described is None:
        return check.not_checked
    return (*check.not_checked, *(f"in the description: {words}" for words in described.not_checked),
            "ways between poses are not checked with the shapes of the description")  # fmt: skip


def _test_joints(request: PlanRequest, model: RobotModel, check: CollisionCheck) -> Array:
    if request.tests is not None:
        return read_joints(request.tests, model)
    return measurable_postures(
        model, MotionLimits(), _TEST_POSES, filters=(check.is_free,), seed=request.seed + 1
    )


def _choose_poses(
    request: PlanRequest, prediction: MeasurementPrediction, drawn: Array, tests: TestPoses
) -> tuple[PosePlan | None, AccuracyPrediction, str, MeasurementPrediction]:
    if request.acceptance is None:
        plan = choose_poses(
            prediction,
            drawn,
            request.poses,
            tests,
            criterion=request.criterion or DesignCriterion.TEST_POSES,
        )
        return plan, plan.prediction, "", plan.after
    found = enough_poses(
        prediction, drawn, request.acceptance, tests, most=request.poses, criterion=request.criterion
    )
    return found.plan, found.prediction, found.reason, found.after


def _predict_random(
    prediction: MeasurementPrediction, drawn: Array, tests: TestPoses, plan: PosePlan | None
) -> AccuracyPrediction | None:
    if plan is None or not len(plan.indices):
        return None
    generator = np.random.default_rng(0)
    draws: Sequence[AccuracyPrediction] = sorted(
        (
            predict_accuracy(
                prediction.with_measured(
                    drawn[generator.choice(len(drawn), len(plan.indices), replace=False)]
                ),
                tests,
            )
            for _ in range(_RANDOM_PLANS)
        ),
        key=lambda accuracy: accuracy.tip_rms_m,
    )
    return draws[_RANDOM_PLANS // 2]
