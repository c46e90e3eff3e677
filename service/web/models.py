"""The robot as a picture: a description of cylinders and balls, and what stands around it.

The description comes from the same model table that the solver uses, and from the same shapes that plans are
checked with: the picture and the mathematics cannot disagree. It shows the nominal arm, not the calibrated one: the
difference is less than a pixel.
"""

import asyncio
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated
from xml.etree import ElementTree as ET

import numpy as np
from fastapi import APIRouter, Path, Request, Response

from cellcal.calibration.documents.xml_text import parse_xml
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.configuration.instrument_tables import GaugeEntry
from cellcal.service.web.dependencies import Who, app_context

if TYPE_CHECKING:
    from cellcal.calibration.arm.kinematics import RobotModel
    from cellcal.calibration.geometry import Array
    from cellcal.calibration.motion.cell_shapes import LinkCapsule
    from cellcal.procedures.surroundings import Surroundings

router = APIRouter()
Triple = tuple[float, float, float]
RobotName = Annotated[str, Path(max_length=64)]

_TOOL = "tool"
_TOOL_RGB = "#8c99a6"
# What stands in the name of a model or a driver, and the colours of that make's arms and of their joints.
_ARM_RGB: tuple[tuple[str, str, str], ...] = (
    (r"fanuc", "#f7c600", "#45545f"),
    (r"kuka", "#e8500a", "#2b2f33"),
    (r"abb", "#eceff1", "#4a4f55"),
    (r"yaskawa|motoman", "#1f5fbf", "#dfe5ea"),
    (r"^ur\d|^universal", "#b9c3cb", "#56a0d3"),
    (r"", "#9aa8b4", "#45545f"),  # no make that is known here
)
_HOUSING_RADIUS, _HOUSING_LENGTH = 1.12, 2.5  # of a joint, as a share of its link's radius: for the eye only
_SMALL_RADIUS_M = 0.03  # of a joint's housing where no shape of the arm is known


@dataclass(frozen=True, slots=True)
class BoxSeen:
    """A box that stands in the cell."""

    name: str
    base_box: tuple[float, ...]  # (4, 4) row by row: its centre and axes [m]
    size_m: Triple


@dataclass(frozen=True, slots=True)
class BallSeen:
    """A ball that stands in the cell."""

    name: str
    centre_in_base_m: Triple
    radius_m: float


@dataclass(frozen=True, slots=True)
class PlaneSeen:
    """A floor or wall: solid on the other side from its normal."""

    name: str
    point_in_base_m: Triple
    normal_in_base: Triple


@dataclass(frozen=True, slots=True)
class WirePlacement:
    """The draw-wire as the cell file places it: from its anchor in the base to its hook on the flange."""

    name: str
    anchor_in_base_m: Triple
    hook_in_flange_m: Triple


@dataclass(frozen=True, slots=True)
class CellSeen:
    """All that a picture of one robot in its cell needs beside the description.

    The description's joints are ``description_from_controller @ joints_rad``: a description cannot couple joints,
    a controller does (FANUC's J3 is told against the horizon).
    """

    robot: str
    model: str
    title: str
    arm_rgb: str  # of the make, as #rrggbb
    joints: tuple[str, ...]
    description_from_controller: tuple[tuple[float, ...], ...]
    boxes: tuple[BoxSeen, ...]
    balls: tuple[BallSeen, ...]
    planes: tuple[PlaneSeen, ...]
    wire: WirePlacement | None
    remarks: tuple[str, ...]  # what of the shapes was assumed


@router.get(
    "/models/{robot}.urdf",
    response_class=Response,
    responses={200: {"content": {"application/xml": {}}, "description": "URDF"}},
)
async def get_description(robot: RobotName, request: Request, who: Who) -> Response:
    """Return a robot of this cell as a URDF of cylinders and balls; links ``base``, ``link_1`` …, ``flange``."""
    del who
    urdf = await asyncio.to_thread(primitive_urdf, app_context(request).config, robot)
    return Response(urdf, media_type="application/xml")


@router.get("/models/{robot}.json")
async def get_surroundings(robot: RobotName, request: Request, who: Who) -> CellSeen:
    """Return what stands around a robot, its wire, and how its joints drive the description."""
    del who
    return await asyncio.to_thread(describe_surroundings, app_context(request).config, robot)


def primitive_urdf(config: CellConfig, robot: str) -> str:
    """Return the description of one robot: each shape of its links as a cylinder with a ball at either end.

    Raises
    ------
    CellError
        There is no such robot in the cell.
    """
    from cellcal.calibration.arm.urdf import bare_urdf  # noqa: PLC0415  # heavy: not at the start of the service

    model, shapes, _ = _arm_shapes(config, robot)
    root: ET.Element = parse_xml(bare_urdf(model, geometric_joints=True))
    arm_rgb, joint_rgb = _colours_of_make(config, robot)
    for name, rgb in (("arm", arm_rgb), ("joint", joint_rgb), (_TOOL, _TOOL_RGB)):
        shares = " ".join(f"{int(rgb[at : at + 2], 16) / 255:.3f}" for at in (1, 3, 5))
        ET.SubElement(ET.SubElement(root, "material", name=name), "color", rgba=f"{shares} 1")
    links = {str(link.get("name")): link for link in root.findall("link")}
    for capsule in shapes:
        at = "base" if capsule.link == 0 else f"link_{capsule.link}"
        # The capsule's frame lies behind the placement that ends the link, the description's link before it.
        _draw_capsule(links[at], capsule, model.placements[capsule.link])
    radius = min((c.radius_m for c in shapes if c.name != _TOOL), default=_SMALL_RADIUS_M)
    for joint in range(1, model.axis_count + 1):
        _draw_cylinder(
            links[f"link_{joint}"],
            np.zeros(3),
            np.array([0.0, 0.0, _HOUSING_LENGTH * radius]),
            _HOUSING_RADIUS * radius,
            "joint",
        )
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def describe_surroundings(config: CellConfig, robot: str) -> CellSeen:
    """Return what stands around one robot, as its cell file tells.

    Raises
    ------
    CellError
        There is no such robot in the cell.
    """
    from cellcal.calibration.arm.urdf import bare_urdf  # noqa: PLC0415  # heavy: not at the start of the service

    model, _, remarks = _arm_shapes(config, robot)
    space, gauge = _robot_surroundings(config, robot), config.gauge_for(robot)
    bare: ET.Element = parse_xml(bare_urdf(model, geometric_joints=True))
    signs = [float(str(axis.get("xyz")).split()[2]) for axis in bare.iter("axis")]
    driven = np.array(signs)[:, None] * model.joint_coupling
    return CellSeen(
        robot=robot,
        model=config.robot_named(robot).model,
        title=model.title,
        arm_rgb=_colours_of_make(config, robot)[0],
        joints=model.joint_names,
        description_from_controller=tuple(tuple(float(v) for v in row) for row in driven),
        boxes=tuple(
            BoxSeen(box.name, tuple(float(v) for v in box.base_box.to_matrix().ravel()), box.size_m)
            for box in space.blocks
        ),
        balls=tuple(BallSeen(ball.name, ball.centre_in_base_m, ball.radius_m) for ball in space.balls),
        planes=tuple(PlaneSeen(p.name, p.point_in_base_m, p.normal_in_base) for p in space.planes),
        wire=None if gauge is None else _describe_wire(gauge),
        remarks=remarks,
    )


def _colours_of_make(config: CellConfig, robot: str) -> tuple[str, str]:
    """Return the colours of a robot's arm and of its joints, by the name of its model or else of its driver."""
    entry = config.robot_named(robot)
    makes = [each for each in _ARM_RGB if re.search(each[0], entry.model.lower())]
    if len(makes) == 1:  # the model's name tells nothing
        makes = [each for each in _ARM_RGB if re.search(each[0], entry.driver)]
    _, arm_rgb, joint_rgb = makes[0]
    return arm_rgb, joint_rgb


def _describe_wire(gauge: GaugeEntry) -> WirePlacement:
    return WirePlacement(gauge.device.name, gauge.setup.anchor_in_base_m, gauge.setup.hook_in_flange_m)


def _robot_surroundings(config: CellConfig, robot: str) -> "Surroundings":
    return config.motion_of(robot).surroundings


def _arm_shapes(
    config: CellConfig, robot: str
) -> tuple["RobotModel", tuple["LinkCapsule", ...], tuple[str, ...]]:
    from cellcal.calibration.arm.kinematics import load_model  # noqa: PLC0415  # heavy, as above
    from cellcal.procedures.surroundings import cell_shape  # noqa: PLC0415  # heavy, as above

    model = load_model(config.robot_named(robot).model)
    gauge = config.gauge_for(robot)
    space = _robot_surroundings(config, robot)
    hook = None if gauge is None else gauge.setup.hook_in_flange_m
    shape = cell_shape(model, space, None, space.tip_in_flange_m or hook)
    return model, shape.arm, shape.assumed


def _draw_capsule(link: ET.Element, capsule: "LinkCapsule", link_frame: "Array") -> None:
    ends = [
        link_frame[:3, :3] @ np.array(end) + link_frame[:3, 3] for end in (capsule.start_m, capsule.end_m)
    ]
    colour = _TOOL if capsule.name == _TOOL else "arm"
    middle, along = (ends[0] + ends[1]) / 2, ends[1] - ends[0]
    _draw_cylinder(link, middle, along, capsule.radius_m, colour)
    for end in ends:
        ball = _add_visual(link, end, (0.0, 0.0, 0.0), colour)
        ET.SubElement(ball, "sphere", radius=f"{capsule.radius_m:.6g}")


def _draw_cylinder(link: ET.Element, middle: "Array", along: "Array", radius_m: float, colour: str) -> None:
    """Draw a round bar of the length of ``along``; a description's cylinder lies along its own z."""
    length = float(np.linalg.norm(along))
    x, y, z = along
    turn = (0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)))
    bar = _add_visual(link, middle, turn, colour)
    ET.SubElement(bar, "cylinder", radius=f"{radius_m:.6g}", length=f"{length:.6g}")


def _add_visual(link: ET.Element, xyz: "Array", rpy: Triple, colour: str) -> ET.Element:
    visual = ET.SubElement(link, "visual")
    ET.SubElement(
        visual, "origin", xyz=" ".join(f"{v:.6g}" for v in xyz), rpy=" ".join(f"{v:.6g}" for v in rpy)
    )
    geometry = ET.SubElement(visual, "geometry")
    ET.SubElement(visual, "material", name=colour)
    return geometry
