"""Any six-axis robot in the demo: what the fakes are told of it, and where wire and floor go beside it.

Gears, masses and stiffnesses of a described arm are the fakes' own generic ones: no description holds them.
"""

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.dh_of_chain import dh_of_chain
from cellcal.calibration.arm.joint_kinds import drawn_range
from cellcal.calibration.arm.kinematics import RobotModel, chain_frames, load_model
from cellcal.calibration.arm.model_references import fixed_reference, parse_reference
from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import describe_unreadable, read_plain_text
from cellcal.calibration.documents.toml_text import parse_toml
from cellcal.calibration.errors import CalibrationError, CellError, DegenerateDataError
from cellcal.calibration.geometry import Array
from cellcal.calibration.motion.cell_shapes import CellShape, PlaneObstacle, arm_shape
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.poses.measurement_poses import measurable_postures

GENERIC = "generic"
HOOK_IN_FLANGE_M = (0.06, 0.05, 0.12)
_AXES = 6
_MODBUS = "modbus_robot"
# Models that the fakes know by themselves, behind the wire that they know them behind.
KNOWN_TO_FAKES = {
    "modbus_robot": {"fanuc_m6ib"},
    "fanuc_rmi": {"fanuc_m6ib"},
    "universal_robots": {"ur3", "ur3e", "ur5", "ur5e", "ur10", "ur10e", "ur16e", "ur20", "ur30"},
}
# Around the demo's own FANUC M-6iB, seen from the height of its second axis, by its reach.
_REACH_M = 1.573
_ANCHOR_M, _MOUTH_M, _RANGE_M = (0.9, -0.7, -0.45), (0.75, 0.0, 0.55), 3.0
_FLOOR_M, _PARKED_M = -1.5, (0.85, -0.3, 0.1)
_THICK = (0.05, 0.035, 0.025)
_TOUCHING_M = 0.005  # pairs that are always nearer are one body, whatever distance a procedure keeps
_POSTURES = 2000
_CANDIDATES = 800
_ROOM = 2.0  # how much room counts beside dexterity and place


@dataclass(frozen=True, eq=False)
class DemoArm:
    """One robot of the demo, and what stands beside it."""

    model: RobotModel
    park_rad: Array  # (n,)
    anchor_in_base_m: tuple[float, float, float]
    mouth_in_base_m: tuple[float, float, float]
    wire_range_m: float
    floor_m: float  # height of the floor in the base
    link_radius_m: float  # how thick its links are taken

    @property
    def title(self) -> str:
        """The name for people."""
        return self.model.title


def plan_demo_arm(reference: str) -> DemoArm:
    """Return a robot with a wire, a floor and a posture to begin in that suit its size.

    Raises
    ------
    CellError
        No such robot, or one that the fakes do not play.
    """
    model = load_model(fixed_reference(reference, Path.cwd()))
    refuse_unplayable(model)
    reach, height = _size(model)
    scale = reach / _REACH_M

    def placed(point: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (round(scale * value, 4) for value in point)
        return x, y, round(z + height, 4)

    anchor, mouth = placed(_ANCHOR_M), placed(_MOUTH_M)
    floor = placed((0.0, 0.0, _FLOOR_M))[2]
    wire = WirePath(anchor, HOOK_IN_FLANGE_M, round(scale * _RANGE_M, 3))
    place = np.array(placed(_PARKED_M))
    # Links that are close by construction are left out where they touch, and in the way where they nearly do.
    parked = [_parked(model, wire, floor, place, radius) for radius in _radii(model)]
    best = max(parked, key=lambda each: each.room_m)
    return DemoArm(model, best.joints_rad, anchor, mouth, wire.range_m, floor, best.link_radius_m)


def describe_arms(cell_file: Path) -> dict[str, dict[str, object]]:
    """Return what the fakes are told of the robots that a cell file names, by their names in it.

    Raises
    ------
    CellError
        A robot that the fakes do not play.
    """
    try:
        document = parse_toml(read_plain_text(cell_file))
    except (OSError, DocumentError) as broken:
        raise CellError(describe_unreadable(cell_file, broken), code="fake") from broken
    found = {}
    for table in document.get("robot", []):
        name, driver = str(table.get("model", "")), str(table.get("driver", ""))
        if not name or name in KNOWN_TO_FAKES.get(driver, ()) or parse_reference(name).mounting:
            continue  # arms that hang they do not play
        model = load_model(fixed_reference(name, cell_file.absolute().parent))
        refuse_unplayable(model)
        park = np.degrees(_begins_at(document, table, model)).tolist()
        found[str(table.get("name"))] = described(model, park, drives=driver == _MODBUS)
    return found


def described(model: RobotModel, park_deg: list[float], *, drives: bool) -> dict[str, object]:
    """Return what the fakes are told of one arm."""
    table = dh_of_chain(model)
    rows = np.column_stack(
        [np.degrees(table.rows[:, 0]), table.rows[:, 1:3] * 1e3, np.degrees(table.rows[:, 3])]
    )
    return {
        "title": model.title,
        "dh": rows.tolist(),
        "joint_coupling": model.joint_coupling.tolist(),
        "base": table.base.tolist(),
        "flange": table.flange.tolist(),
        "lower_deg": np.degrees(model.lower_rad).tolist(),
        "upper_deg": np.degrees(model.upper_rad).tolist(),
        "speed_deg_s": np.degrees(model.max_speed_rad_s).tolist(),
        "park_deg": park_deg,
        **({"drive": GENERIC} if drives else {}),
    }


def write_described(folder: Path, arms: Mapping[str, Any]) -> Path:
    """Write descriptions for the fakes into a folder."""
    path = folder / "arms.json"
    path.write_text(json.dumps(arms), encoding="utf-8")
    return path


def refuse_unplayable(model: RobotModel) -> None:
    """Refuse an arm that the fakes do not play.

    Raises
    ------
    CellError
        It has not six axes, or one of them slides.
    """
    if model.axis_count != _AXES or model.sliding is not None:
        slides = "" if model.sliding is None else f", {int(model.sliding.sum())} of them sliding"
        name = model.label
        raise CellError(
            f"{model.title} has {model.axis_count} axes{slides}: the demo loses and restores the mastering of a "
            "controller with six turning axes, and its fakes play no other.",
            remedy="Choose a robot of six axes (`cellcal models '6 axis'`). For this robot: `cellcal poses --robot "
            f"{name} --sigma-mm 0.05` plans measurements, `cellcal identify FILE --robot {name}` calibrates, and "
            "`cellcal program` changes its programs.",
            code="usage",
        )


def _radii(model: RobotModel) -> list[float]:
    """Return how thick links may be taken: shares of the length of all of them."""
    length = float(np.linalg.norm(model.placements[1:, :3, 3], axis=1).sum())
    return [round(share * length, 3) for share in _THICK]


def _size(model: RobotModel) -> tuple[float, float]:
    """Return how far the flange gets from the first axis, and how high the second axis is [m]."""
    low, high = drawn_range(model)
    joints = np.random.default_rng(1).uniform(low, high, (_POSTURES, model.axis_count))
    places = model.base_flange(joints)[:, :3, 3]
    _, origins = chain_frames(model, np.zeros((1, model.axis_count)))
    return float(np.hypot(places[:, 0], places[:, 1]).max()), float(origins[1, 2, 0])


@dataclass(frozen=True, eq=False)
class _Parked:
    """A posture to begin in, the narrowest room between shapes there beyond what is kept, and how thick links are."""

    joints_rad: Array
    room_m: float
    link_radius_m: float


def _parked(
    model: RobotModel, wire: WirePath | None, floor_m: float, place: Array, radius_m: float
) -> _Parked:
    """Return a posture with the flange near a place, away from singularities, limits and shapes."""
    floor = PlaneObstacle("floor", (0.0, 0.0, floor_m), (0.0, 0.0, 1.0))
    links = arm_shape(model, radius_m=radius_m, tip_in_flange_m=HOOK_IN_FLANGE_M)
    plain = CollisionCheck.from_model(model, CellShape(links, (floor,), wire, margin_m=_TOUCHING_M))
    joints = measurable_postures(
        model,
        MotionLimits(wire=wire, joint_margin_rad=0.3),
        _CANDIDATES,
        tip_in_flange_m=HOOK_IN_FLANGE_M,
        filters=(plain.is_free,),
    )
    flange, jacobian = model.flange_jacobian(joints)
    away = np.linalg.norm(flange[:, :3, 3] - place, axis=1) / np.linalg.norm(place)
    dexterity = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    # Turns that are not known yet need room between all shapes: of each pair, as much as it ever has.
    clearances = plain.compute_clearances(joints)
    room = clearances.found - clearances.limit
    relative_room = (room / room.max(axis=0)).min(axis=1)
    best = int(np.argmax(dexterity / dexterity.max() - away + _ROOM * relative_room / relative_room.max()))
    return _Parked(np.round(joints[best], 3), float(room[best].min()), radius_m)


def _first_parked(model: RobotModel, floor_m: float, place: Array) -> Array:
    """Return a posture with the thickest links that leave one: those of some arms are close by construction."""
    *thicker, thinnest = _radii(model)
    for radius_m in thicker:
        with contextlib.suppress(DegenerateDataError):
            return _parked(model, None, floor_m, place, radius_m).joints_rad
    return _parked(model, None, floor_m, place, thinnest).joints_rad


def _begins_at(document: Mapping[str, Any], table: Mapping[str, Any], model: RobotModel) -> Array:
    """Return where an arm of a cell file stands at first: as the file says, or by itself near its middle."""
    name = table.get("name")
    stated = document.get("fake", {}).get("park_deg", {}).get(name)
    if stated is None:
        reach, height = _size(model)
        place = np.array([0.55 * reach, -0.2 * reach, height])
        return _first_parked(model, height - 2.0 * reach, place)
    values: Array = np.radians(np.asarray(stated, dtype=float))
    if (
        values.shape != (model.axis_count,)
        or not ((values > model.lower_rad) & (values < model.upper_rad)).all()
    ):
        raise CalibrationError(
            f"[fake.park_deg] of {name} needs {model.axis_count} angles within the limits of {model.title}."
        )
    return values
