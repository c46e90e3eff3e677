"""Cells for tests: for each procedure of the catalogue a cell in which it can succeed, and its spec."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.geometry import Pose, homogeneous, quaternion_from_rotation
from calibration.kinematics import load_model
from calibration.mastering import MasteringRecord
from procedures.cell import Cell, GaugeSetup, MotionLimits
from procedures.mastering_record import MasteringRecordSpec, mastering_record
from procedures.mastering_recovery import MasteringRecoverySpec
from procedures.run import Run
from procedures.six_point_tcp import SixPointTcp
from procedures.three_point_frame import ThreePointFrame
from tests.procedures.ideal import Hands, IdealArm, IdealWire
from tests.procedures.ledgers import MemoryLedger

TIP = (0.012, -0.034, 0.215)
LOST = (1, -2, 3, 0, 1, -1)


@dataclass
class Scene:
    """A cell with its truth, and what is to be run in it."""

    arm: IdealArm
    wire: IdealWire
    hands: Hands
    cell: Cell
    spec: Any


def scene(spec: Any = None) -> Scene:
    """Return a healthy cell."""
    arm = IdealArm(model=load_model("fanuc_m6ib"))
    wire, hands = IdealWire(arm), Hands()
    hands.does["power_cycle"] = arm.power_cycle
    cell = Cell(
        "test",
        arm,
        hands,
        jogs=arm,
        mastering=arm,
        tool_frames=arm,
        user_frames=arm,
        gauge=wire,
        gauge_setup=GaugeSetup((0.9, -0.7, -0.45), (0.06, 0.05, 0.12)),
        model=arm.model,
        limits=MotionLimits(settle_s=0.0),
        config_sha256="c0ffee",
    )
    return Scene(arm, wire, hands, cell, spec)


def recording() -> Scene:
    """Return a healthy cell that takes its mastering record."""
    return scene(MasteringRecordSpec(poses=20, samples=2))


_known: dict[str, MasteringRecord] = {}


async def record_of(made: Scene) -> MasteringRecord:
    """Take the record of a scene's robot; the same one for every scene of this process."""
    if "record" not in _known:
        result = await mastering_record(Run(made.cell, MemoryLedger()), MasteringRecordSpec(samples=2))
        _known["record"] = result.record
    return _known["record"]


async def recovering(lost: tuple[int, ...] = LOST) -> Scene:
    """Return a cell that lost its encoders after its record was taken, and was seen healthy just before."""
    record = await record_of(scene())
    made = scene()
    made.arm.put(np.array([0.2, 0.1, -0.3, 0.4, 0.5, -0.6]))
    last = await made.arm.encoder_counts()
    made.arm.lose_encoders(lost)
    made.cell = replace(made.cell, record=record)
    made.spec = MasteringRecoverySpec(last_counts=last, samples=2)
    return made


def _turned(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    j, k = [(1, 2), (0, 2), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[j, k], matrix[k, j] = (-s, s) if axis != 1 else (s, -s)
    return matrix


def touching() -> Scene:
    """Return a cell whose technician teaches six points with a known tool."""
    made = scene(SixPointTcp(tool_number=3))
    pin, square = np.array([0.7, 0.1, 0.3]), np.diag([1.0, -1.0, -1.0])
    attitudes = {
        "touch": square,
        "touch_about_x": square @ _turned(0, 2.0),
        "touch_about_y": square @ _turned(1, 1.2),
    }

    def place(rotation: np.ndarray, point: np.ndarray) -> Callable[[], None]:
        pose = Pose.from_matrix(homogeneous(rotation, point - rotation @ np.array(TIP)))
        return lambda: setattr(made.arm, "taught", pose)

    for key, rotation in attitudes.items():
        made.hands.does[key] = place(rotation, pin)
    tool = tool_rotation()
    for axis, key in enumerate(("along_x", "along_y", "along_z")):
        made.hands.does[key] = place(square, pin + square @ tool[:, axis] * 0.31)
    return made


def tool_rotation() -> np.ndarray:
    """Return the axes of the tool in the flange."""
    return _turned(2, 0.4) @ _turned(0, 0.2)


def tool_pose() -> Pose:
    """Return the true tool frame."""
    w, x, y, z = (float(v) for v in quaternion_from_rotation(tool_rotation()))
    return Pose(TIP, (w, x, y, z))


FRAME = Pose.from_matrix(homogeneous(_turned(2, 0.7) @ _turned(1, 0.1), np.array([0.6, -0.2, 0.1])))


def pointing() -> Scene:
    """Return a cell whose technician teaches a user frame with a known pointer."""
    made = scene(ThreePointFrame(frame_number=2, tip_in_flange_m=TIP, check_above=True))
    attitude = np.diag([1.0, -1.0, -1.0])
    points = {
        "touch_origin": (0.0, 0.0, 0.0),
        "touch_on_x": (0.4, 0.0, 0.0),
        "touch_on_xy": (0.1, 0.3, 0.0),
        "touch_above": (0.1, 0.1, 0.05),
    }
    for key, point in points.items():
        tip = FRAME.rotation() @ np.array(point) + np.array(FRAME.position_m)
        pose = Pose.from_matrix(homogeneous(attitude, tip - attitude @ np.array(TIP)))
        made.hands.does[key] = lambda pose=pose: setattr(made.arm, "taught", pose)
    return made


async def scene_for(name: str) -> Scene:
    """Return a scene in which the procedure of this name succeeds."""
    if name == "mastering_recovery":
        return await recovering()
    return {"mastering_record": recording, "six_point_tcp": touching, "three_point_frame": pointing}[name]()
