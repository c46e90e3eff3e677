"""What the cell file knows of shapes: of the arm, of its tool, and of what stands around it. Plain values.

Plans carry them, the journal keeps them, and `clearances` makes the check of them that plans and the gate share.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

from cellcal.calibration.arm.kinematics import RobotModel, load_model
from cellcal.calibration.geometry import Pose
from cellcal.calibration.message import make_message
from cellcal.calibration.motion.cell_shapes import (
    BoxObstacle,
    CellShape,
    LinkCapsule,
    Obstacle,
    PlaneObstacle,
    SphereObstacle,
    arm_shape,
    assumed_shape,
)
from cellcal.calibration.motion.collision import CollisionCheck
from cellcal.calibration.motion.motion_check import WirePath
from cellcal.procedures.setting_texts import BOX_HIGH, BOX_LOW, SHAPE_NAME, describe_setting

Triple = tuple[float, float, float]

UNKNOWN_SPEED_SHARE = 0.5  # of every cap, while the cell's obstacles are not described


@dataclass(frozen=True, slots=True)
class BoxBlock:
    """A box that stands in the cell."""

    name: Annotated[str, SHAPE_NAME]
    base_box: Annotated[
        Pose,
        describe_setting(
            "Middle and turn of the box",
            "Where the middle of the box is in the robot's base, and how it is turned.",
            "shapes",
            unit="m",
            drawing="box",
        ),
    ]
    size_m: Annotated[
        Triple,
        describe_setting(
            "Size of the box",
            "Whole lengths of its edges along its x, y and z.",
            "shapes",
            unit="m",
            drawing="box",
        ),
    ]


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Shapes of arm and cell; the workspace that arm and tool stay inside. Without obstacles nothing is known."""

    blocks: Annotated[
        tuple[BoxBlock, ...], describe_setting("Boxes", "Boxes that stand in the cell.", "shapes")
    ] = ()
    balls: Annotated[
        tuple[SphereObstacle, ...],
        describe_setting("Round obstacles", "Round obstacles in the cell.", "shapes"),
    ] = ()
    planes: Annotated[
        tuple[PlaneObstacle, ...],
        describe_setting("Floors, walls and tables", "Flat faces that nothing may pass.", "shapes"),
    ] = ()
    capsules: Annotated[
        tuple[LinkCapsule, ...],
        describe_setting(
            "Shapes of the arm's links", "Bars about the links, where they were measured.", "shapes"
        ),
    ] = ()
    link_radius_m: Annotated[
        float | None,
        describe_setting(
            "Radius of every link",
            "Half the thickness of all links that have no shape of their own.",
            "shapes",
            unit="m",
        ),
    ] = None
    tip_in_flange_m: Annotated[
        Triple | None,
        describe_setting(
            "End of the tool, seen from the flange",
            "What hangs on the flange reaches to this point.",
            "shapes",
            unit="m",
            drawing="tip",
        ),
    ] = None
    margin_m: Annotated[
        float,
        describe_setting(
            "Distance to obstacles", "The arm keeps at least this distance.", "motion", unit="m"
        ),
    ] = 0.02
    wire_margin_m: Annotated[
        float,
        describe_setting(
            "Distance of the wire to obstacles",
            "The draw-wire keeps at least this distance.",
            "motion",
            unit="m",
        ),
    ] = 0.05
    box_low_m: Annotated[Triple | None, BOX_LOW] = None
    box_high_m: Annotated[Triple | None, BOX_HIGH] = None

    @property
    def is_known(self) -> bool:
        """Whether the cell file describes what stands in the cell."""
        return bool(self.blocks or self.balls or self.planes)

    @property
    def speed_share(self) -> float:
        """The share of a speed cap that may be used."""
        return 1.0 if self.is_known else UNKNOWN_SPEED_SHARE

    def list_obstacles(self) -> tuple[Obstacle, ...]:
        """Return what stands in the cell."""
        boxes = tuple(
            BoxObstacle(block.name, block.base_box.to_matrix(), block.size_m) for block in self.blocks
        )
        return (*boxes, *self.balls, *self.planes)


NOTHING_KNOWN = Surroundings()


@lru_cache(maxsize=128)
def clearance_check(
    model_name: str,
    surroundings: Surroundings,
    wire: WirePath | None = None,
    tip_in_flange_m: Triple | None = None,
) -> CollisionCheck:
    """Return the check of distances of one arm in its cell; ``tip_in_flange_m`` is what hangs on the flange.

    Raises
    ------
    CalibrationError
        A shape is on a link that the arm does not have.
    """
    model = load_model(model_name)
    return CollisionCheck.from_model(model, cell_shape(model, surroundings, wire, tip_in_flange_m))


def cell_shape(
    model: RobotModel,
    surroundings: Surroundings,
    wire: WirePath | None = None,
    tip_in_flange_m: Triple | None = None,
) -> CellShape:
    """Return the shapes of an arm in its cell; unmeasured links are assumed and marked as such."""
    shapes = surroundings
    tip = tip_in_flange_m or shapes.tip_in_flange_m or (wire.hook_in_flange_m if wire else None)
    arm, assumed = shapes.capsules, tuple[str, ...]()
    if not arm and shapes.link_radius_m is not None:
        arm = arm_shape(model, radius_m=shapes.link_radius_m, tip_in_flange_m=tip)
        assumed = (
            make_message(
                "links are taken as {link_radius_mm:.0f} mm round about the kinematic skeleton",
                link_radius_mm=shapes.link_radius_m * 1000.0,
            ),
        )
    elif not arm:
        shape = assumed_shape(model, tip_in_flange_m=tip)
        arm, assumed = shape.arm, shape.assumed
    return CellShape(arm, shapes.list_obstacles(), wire, shapes.margin_m, shapes.wire_margin_m, assumed)
