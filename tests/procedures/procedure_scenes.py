"""Cells for tests: for each procedure of the catalogue a cell in which it can succeed, and its spec."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.geometry import Pose, homogeneous_matrix, quaternion_from_rotation
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.points.alignment import Alignment
from cellcal.calibration.points.three_two_one import Corner
from cellcal.drivers.interfaces import Counts, MasteringData
from cellcal.procedures.accuracy_check import AccuracyCheck, CheckRules
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.arm.arm_bench import Method
from cellcal.procedures.arm.calibration_spec import RobotCalibration
from cellcal.procedures.arm.drift_plan import DriftRules
from cellcal.procedures.arm.series_rules import SeriesRules
from cellcal.procedures.base_to_base import BaseToBaseSpec
from cellcal.procedures.cell import Cell, GaugeSetup, MasteringBackup, MotionCaps, MotionLevel, TrackerSetup
from cellcal.procedures.drift_check import DriftCheck, drift_check
from cellcal.procedures.end_effector_points import EndEffectorPoints
from cellcal.procedures.fixture_alignment import FixtureAlignment, fixture_alignment
from cellcal.procedures.frame_offset import FrameOffset
from cellcal.procedures.mastering_record import MasteringRecordSpec, mastering_record
from cellcal.procedures.mastering_recovery import MasteringRecoverySpec
from cellcal.procedures.mastering_undo import MasteringUndo, mastering_sha256
from cellcal.procedures.probed_frame import ProbedFrame
from cellcal.procedures.run import Run
from cellcal.procedures.simulation_cell import SimulationCell
from cellcal.procedures.six_point_tcp import SixPointTcp
from cellcal.procedures.survey.survey import SurveyRules
from cellcal.procedures.teaching.corner_places import CornerRules
from cellcal.procedures.three_point_frame import ThreePointFrame
from tests.procedures.ideal_devices import ZERO, IdealArm, IdealTracker, IdealWire, ScriptedTechnician
from tests.procedures.memory_ledgers import MemoryLedger
from tests.procedures.probed_corner import (
    CornerContact,
    ProbingArm,
    corner_below,
    home_at,
    pose_offset,
    with_probe,
)
from tests.unit.helpers.tag_paths import FIXTURE_BASE, two_paths

Triple = tuple[float, float, float]
TIP = (0.012, -0.034, 0.215)
LOST = (1, -2, 3, 0, 1, -1)
TARGET = (0.08, 0.04, 0.1)


@dataclass
class ProcedureScene:
    """A cell with its truth, and what is to be run in it."""

    arm: IdealArm
    wire: IdealWire
    technician: ScriptedTechnician
    cell: Cell
    spec: Any


def healthy_scene(spec: Any = None) -> ProcedureScene:
    """Return a healthy cell."""
    arm = IdealArm(model=load_model("fanuc_m6ib"))
    wire, hands = IdealWire(arm), ScriptedTechnician()
    hands.does["power_cycle"] = arm.power_cycle
    cell = Cell(
        "test",
        arm,
        hands,
        jogs=arm,
        mastering=arm,
        tool_frames=arm,
        user_frames=arm,
        frames=arm,
        mode=arm,
        gauge=wire,
        tracker=IdealTracker(arm),
        tracker_setup=TrackerSetup(TARGET),
        gauge_setup=GaugeSetup((0.9, -0.7, -0.45), (0.06, 0.05, 0.12)),
        model=arm.model,
        limits=MotionCaps(settle_s=0.0),
        level=MotionLevel.COMMANDED,
        config_sha256="c0ffee",
    )
    return ProcedureScene(arm, wire, hands, cell, spec)


def recording_scene() -> ProcedureScene:
    """Return a healthy cell that takes its mastering record."""
    return healthy_scene(MasteringRecordSpec(poses=20, samples=2))


_record_cache: dict[str, MasteringRecord] = {}


async def record_of(made: ProcedureScene) -> MasteringRecord:
    """Take the record of a scene's robot; the same one for every scene of this process."""
    if "record" not in _record_cache:
        result = await mastering_record(Run(made.cell, MemoryLedger()), MasteringRecordSpec(samples=2))
        _record_cache["record"] = result.record
    return _record_cache["record"]


async def recovery_scene(lost: tuple[int, ...] = LOST) -> ProcedureScene:
    """Return a cell that lost its encoders after its record was taken, and was seen healthy just before."""
    record = await record_of(healthy_scene())
    made = healthy_scene()
    made.arm.write_program(np.array([0.2, 0.1, -0.3, 0.4, 0.5, -0.6]))
    last = await made.arm.encoder_counts()
    made.arm.lose_encoders(lost)
    made.cell = replace(made.cell, record=record)
    made.spec = MasteringRecoverySpec(last_counts=last, samples=2)
    return made


def _turned_rotation(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    j, k = [(1, 2), (0, 2), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[j, k], matrix[k, j] = (-s, s) if axis != 1 else (s, -s)
    return matrix


def tool_touch_scene(**more: Any) -> ProcedureScene:
    """Return a cell whose technician teaches six points with a known tool, and turns it as he likes."""
    made = healthy_scene(
        SixPointTcp(tool_number=3, **({"arm_sigma_m": 0.0} | more))
    )  # an arm that obeys exactly
    pin, square = np.array([0.7, 0.1, 0.3]), np.diag([1.0, -1.0, -1.0])
    attitudes = {
        "touch": square,
        "touch_about_x": square @ _turned_rotation(0, 2.0),
        "touch_about_y": square @ _turned_rotation(1, 1.2),
        "touch_2": square @ _turned_rotation(0, 1.0),
        "touch_3": square @ _turned_rotation(2, 1.0),
        "touch_4": square @ _turned_rotation(0, -0.7) @ _turned_rotation(1, -0.7),
        "touch_5": square @ _turned_rotation(2, -1.1),
        "touch_6": square @ _turned_rotation(1, -1.0),
        "touch_7": square @ _turned_rotation(0, 0.8) @ _turned_rotation(2, 0.8),
        "touch_8": square @ _turned_rotation(1, 0.9) @ _turned_rotation(2, -0.5),
        "orient_origin": square,
        "hold_tool": np.diag([1.0, -1.0, -1.0]) @ tool_rotation().T,
    }

    def place_flange(rotation: np.ndarray, point: np.ndarray) -> Callable[[], None]:
        pose = Pose.from_matrix(homogeneous_matrix(rotation, point - rotation @ np.array(TIP)))
        return lambda: setattr(made.arm, "taught", pose)

    for key, rotation in attitudes.items():
        made.technician.does[key] = place_flange(rotation, pin)
    tool = tool_rotation()
    for axis, key in enumerate(("along_x", "along_y", "along_z")):
        made.technician.does[key] = place_flange(square, pin + square @ tool[:, axis] * 0.31)
    return made


def tool_rotation() -> np.ndarray:
    """Return the axes of the tool in the flange."""
    return _turned_rotation(2, 0.4) @ _turned_rotation(0, 0.2)


def tool_pose() -> Pose:
    """Return the true tool frame."""
    w, x, y, z = (float(v) for v in quaternion_from_rotation(tool_rotation()))
    return Pose(TIP, (w, x, y, z))


FRAME = Pose.from_matrix(
    homogeneous_matrix(_turned_rotation(2, 0.7) @ _turned_rotation(1, 0.1), np.array([0.6, -0.2, 0.1]))
)


def user_frame_scene(**more: Any) -> ProcedureScene:
    """Return a cell whose technician teaches a user frame with a known pointer; with ``more`` settings."""
    made = healthy_scene(ThreePointFrame(frame_number=2, tip_in_flange_m=TIP, check_above=True, **more))
    attitude = np.diag([1.0, -1.0, -1.0])
    points = {
        "touch_origin": (0.0, 0.0, 0.0),
        "touch_on_x": (0.4, 0.0, 0.0),
        "touch_on_xy": (0.1, 0.3, 0.0),
        "touch_origin_again": (0.0, 0.0, 0.0),
        "touch_more_on_x": (0.3, 0.0, 0.0),
        "touch_more_on_xy": (0.1, -0.3, 0.0),
        "touch_above": (0.1, 0.1, 0.05),
    }
    for key, point in points.items():
        tip = FRAME.rotation_matrix() @ np.array(point) + np.array(FRAME.position_m)
        pose = Pose.from_matrix(homogeneous_matrix(attitude, tip - attitude @ np.array(TIP)))
        made.technician.does[key] = lambda pose=pose: setattr(made.arm, "taught", pose)
    return made


FIXTURE_POINTS = ((-0.35, -0.45, 0.0), (0.35, -0.45, 0.0), (-0.35, 0.45, 0.0), (0.35, 0.45, 0.25))
BASE_FIXTURE = Pose((0.853, 0.004, -0.196))
TARGETS = ((0.0, 0.0, 0.0), (0.16, 0.0, -0.05), (0.0, 0.16, -0.05))
FLANGE_TOOL = Pose((0.002, -0.003, 0.204))
QUICK = SurveyRules(min_captures=4, max_captures=5, candidates=12, samples=1)
OFFSET_POINTS = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.0, 0.4, 0.0), (0.3, 0.2, 0.1))


def to_outer_frame(pose: Pose, point: Triple) -> Triple:
    """Return a point of a frame seen from outside."""
    x, y, z = pose.rotation_matrix() @ np.array(point) + np.array(pose.position_m)
    return (float(x), float(y), float(z))


def alignment_scene(points: tuple[Triple, ...] = FIXTURE_POINTS[:3], **more: Any) -> ProcedureScene:
    """Return a cell whose technician puts the wire on the points of a fixture."""
    limits = more.pop("limits", FrameLimits(0.03, 0.05))
    rough = Pose((0.85, 0.0, -0.2))
    made = healthy_scene(
        FixtureAlignment("table", points, rough, limits=limits, rules=more.pop("rules", QUICK), **more)
    )
    for number, point in enumerate(points, 1):
        seat = to_outer_frame(BASE_FIXTURE, point)
        made.technician.does[f"mount_wire_{number}"] = lambda seat=seat: setattr(
            made.wire, "anchor_in_base_m", seat
        )
    return made


_wrong_at: list[tuple[float, ...]] = []


async def alignment_with_outlier() -> ProcedureScene:
    """Return a fixture alignment in which the lengths of later spots contradict one of the first.

    It is wrong by its place, as an arm's own error is, however often a run begins anew.
    """

    async def make_scene() -> ProcedureScene:
        rules = SurveyRules(min_captures=6, max_captures=8, candidates=24, samples=1)
        found = alignment_scene(FIXTURE_POINTS, limits=FrameLimits(0.0005, 0.0009), rules=rules)
        found.cell = replace(found.cell, record=await record_of(healthy_scene()))
        return found

    if not _wrong_at:
        healthy, ledger = await make_scene(), MemoryLedger()
        await fixture_alignment(Run(healthy.cell, ledger), healthy.spec)
        third = next(finding for finding in ledger.past().findings if finding.step == "capture 3")
        _wrong_at.append(tuple(third.value["joints_rad"]))
    contradicted = await make_scene()
    contradicted.wire.kink_at = (_wrong_at[0], 0.0015)  # little enough for the lengths of its own spot
    return contradicted


def hook_scene(points: tuple[Triple, ...] = TARGETS, **more: Any) -> ProcedureScene:
    """Return a cell whose technician hangs the wire's hook into points of the end-effector."""
    spec = EndEffectorPoints(
        4, points, Pose((0.0, 0.0, 0.2)), **({"tip_u_m": 0.03, "angle_u_rad": 0.2, "rules": QUICK} | more)
    )
    made = healthy_scene(spec)
    for number, point in enumerate(points, 1):
        hole = to_outer_frame(FLANGE_TOOL, point)
        made.technician.does[f"hook_wire_{number}"] = lambda hole=hole: setattr(
            made.wire, "hook_in_flange_m", hole
        )
    return made


def moved_workpiece_scene(
    old: Pose = FRAME, old_new: Pose | None = None, points: Sequence[Triple] = OFFSET_POINTS
) -> ProcedureScene:
    """Return a cell whose workpiece moved, and whose technician touches its points again."""
    old_new = old_new or Pose.from_matrix(
        homogeneous_matrix(_turned_rotation(2, 0.02), np.array([0.03, -0.02, 0.004]))
    )
    spec = FrameOffset(2, TIP, points_in_frame_m=tuple(points), check_above=True)
    made = healthy_scene(spec)
    made.arm.frames[2] = old
    attitude = np.diag([1.0, -1.0, -1.0])
    places = {f"touch_point_{k}": point for k, point in enumerate(points, 1)} | {
        "touch_above": (0.1, 0.1, 0.2)
    }
    for key, point in places.items():
        tip = np.array(to_outer_frame(old @ old_new, point))
        pose = Pose.from_matrix(homogeneous_matrix(attitude, tip - attitude @ np.array(TIP)))
        made.technician.does[key] = lambda pose=pose: setattr(made.arm, "taught", pose)
    return made


def alignment_of(serial: str, base_fixture: Pose, *, fixture: str = "table", **more: Any) -> Alignment:
    """Return an alignment known within tenths of millimetres."""
    covariance = np.diag([5e-5**2] * 3 + [5e-5**2] * 3)
    rows = tuple(tuple(float(v) for v in row) for row in covariance)
    return Alignment(fixture, serial, "fanuc_m6ib", FIXTURE_POINTS, base_fixture, rows, **more)


def base_to_base_scene() -> ProcedureScene:
    """Return a cell whose journal holds the alignments of two robots with one fixture."""
    made = healthy_scene(BaseToBaseSpec("table"))
    mine = alignment_of("F-1", BASE_FIXTURE, counts_at_zero=ZERO)
    made.cell = replace(made.cell, alignments=(mine, alignment_of("F-2", OTHER_BASE_FIXTURE)))
    return made


OTHER_BASE_FIXTURE = Pose((0.9, 0.2, -0.2), (0.0, 0.0, 0.0, 1.0))


FEW = SeriesRules(
    first=6, batch=2, min_captures=10, max_captures=10, candidates=50, tests=8, samples=1,
    point_min=4, point_max=5, point_checks=1, point_candidates=24,
)  # fmt: skip
WRONG_ZEROS = (0, 20_000, -30_000, 9_000, 8_000, 0)  # counts by which the arm's mastering is off


def calibration_scene(**more: Any) -> ProcedureScene:
    """Return a cell whose robot has wrong zeros, and nothing else."""
    spec = replace(RobotCalibration("tracker", "offsets", tip_u_m=0.002, write_zeros=True, rules=FEW), **more)
    made = healthy_scene(spec)
    made.arm.true_zero = tuple(zero + off for zero, off in zip(ZERO, WRONG_ZEROS, strict=True))
    return made


def tool_calibration_scene(points: tuple[Triple, ...] = TARGETS, **more: Any) -> ProcedureScene:
    """Return such a cell whose technician puts hook or target into points of the end-effector in between."""
    rough = {"points_in_tool_m": points, "rough_flange_tool": Pose((0.0, 0.0, 0.2)), "tool_number": 4}
    made = calibration_scene(**({"write_zeros": False} | rough | more))
    homes = made.wire.hook_in_flange_m, IdealTracker(made.arm).target_in_flange_m

    def place_hook(hook: Triple, target: Triple) -> Callable[[], None]:
        def move_hook() -> None:
            tracker = made.cell.tracker
            assert isinstance(tracker, IdealTracker)
            made.wire.hook_in_flange_m, tracker.target_in_flange_m = hook, target

        return move_hook

    for number, point in enumerate(points, 1):
        hole = to_outer_frame(FLANGE_TOOL, point)
        made.technician.does[f"hook_wire_{number}"] = made.technician.does[f"target_to_point_{number}"] = (
            place_hook(hole, hole)
        )
    made.technician.does["hook_wire_back"] = made.technician.does["target_back"] = place_hook(*homes)
    return made


LITTLE = DriftRules(poses=5, first=4, candidates=40, samples=1)
QUICK_ROUND = CheckRules(cycles=2, placing=10, candidates=32, samples=1)
_references: dict[str, DriftReference] = {}


async def drift_scene(method: Method = "wire", **more: Any) -> ProcedureScene:
    """Return a cell whose robot was healthy when its reference was taken; the caller lets something happen to it."""
    spec = replace(DriftCheck(method, rules=LITTLE), **more)
    key = repr(spec)
    if key not in _references:
        healthy = healthy_scene()
        _references[key] = (await drift_check(Run(healthy.cell, MemoryLedger()), spec)).reference
    made = healthy_scene(spec)
    made.cell = replace(made.cell, drift_references=(_references[key],))
    return made


async def knocked_tool_scene() -> ProcedureScene:
    """Return a cell whose tool was knocked after the reference was taken."""
    made = await drift_scene()
    x, y, z = made.wire.hook_in_flange_m
    made.wire.hook_in_flange_m = (x + 0.001, y - 0.0008, z)
    return made


def round_trip_scene(method: Method = "tracker", **more: Any) -> ProcedureScene:
    """Return a cell whose robot goes round the test poses."""
    return healthy_scene(replace(AccuracyCheck(method, rules=QUICK_ROUND), **more))


def simulation_scene() -> ProcedureScene:
    """Return a cell that is simulated, and whose robot's base is found by tags in its fixture."""
    in_base, in_fixture = two_paths(FIXTURE_BASE, 9)
    return healthy_scene(SimulationCell("base", in_base, in_fixture, nominal=Pose((1.2, 0.0, 0.4))))


WRITTEN = tuple(zero + off for zero, off in zip(ZERO, WRONG_ZEROS, strict=True))


def undo_scene(written: Counts = WRITTEN, before: MasteringData | None = None) -> ProcedureScene:
    """Return a cell whose robot holds a mastering that a run wrote, and whose journal knows the one before."""
    made = healthy_scene(MasteringUndo())
    made.arm.data = MasteringData(written, mastered=True)
    old = MasteringData(ZERO, mastered=True) if before is None else before
    backup = MasteringBackup(
        "mastering_recovery-1",
        "2026-01-02T03:04:05.678+00:00",
        "F-1",
        old,
        made.arm.epoch,
        mastering_sha256(old),
    )
    made.cell = replace(made.cell, backups=(backup,))
    return made


def probing_scene(corner: Corner = "outside", **more: Any) -> ProcedureScene:
    """Return a cell whose robot carries a probe over a corner, which is a little off what the controller holds."""
    rules = CornerRules(corner=corner, repeats=1, **more.pop("rules", {}))
    made = healthy_scene(
        ProbedFrame(frame_number=5, touching=rules, **({"arm_sigma_m": 0.0, "accuracy_class": "C"} | more))
    )
    arm = ProbingArm(model=made.arm.model)
    true = corner_below(arm.model)
    arm.feeler = CornerContact(true, corner)
    arm.frames[5] = pose_offset(true, (0.001, -0.0015, 0.0012), (0.004, -0.006, 0.008))
    home_at(arm, true, (0.05, 0.05, 0.06))
    devices = dict.fromkeys(
        ("robot", "jogs", "mastering", "tool_frames", "user_frames", "frames", "mode"), arm
    )
    made.arm, made.cell = arm, with_probe(replace(made.cell, **devices), arm, 5e-5)  # type: ignore[arg-type]
    return made


async def scene_for(name: str) -> ProcedureScene:
    """Return a scene in which the procedure of this name succeeds."""
    if name == "mastering_recovery":
        return await recovery_scene()
    if name == "drift_check":
        return await knocked_tool_scene()
    if name in ("position_record", "position_cure"):
        from tests.procedures.shown_arm import cure_scene, shown_scene

        return shown_scene() if name == "position_record" else await cure_scene()
    return SCENES[name]()


SCENES: dict[str, Callable[[], ProcedureScene]] = {
    "simulation_cell": simulation_scene,
    "mastering_record": recording_scene,
    "mastering_undo": undo_scene,
    "six_point_tcp": tool_touch_scene,
    "three_point_frame": user_frame_scene,
    "probed_frame": probing_scene,
    "fixture_alignment": alignment_scene,
    "end_effector_points": lambda: hook_scene(TARGETS[:1]),  # one spot: the fixture's scene has more
    "frame_offset": moved_workpiece_scene,
    "base_to_base": base_to_base_scene,
    # One point: what three do more is the same steps twice more. It writes zeros and the tool frame.
    "robot_calibration": lambda: tool_calibration_scene(TARGETS[:1], write_zeros=True),
    "accuracy_check": round_trip_scene,
}
