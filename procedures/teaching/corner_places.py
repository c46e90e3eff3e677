"""Which corner a probe feels, where on its three faces, and what motion must keep to."""

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from cellcal.calibration.points.three_two_one import FACES, LEAST, Corner, FaceName
from cellcal.procedures.motion.plans import MotionBounds
from cellcal.procedures.setting_texts import MAX_TOUCHES, ROOM, describe_setting
from cellcal.procedures.steps.touch import PROBING_CAP_M_S

Triple = tuple[float, float, float]
Length = Annotated[float, Field(ge=0.002, le=1.0)]


@dataclass(frozen=True, slots=True)
class CornerRules:
    """The corner, where it is felt, the care of each touch, and the limits of motion."""

    corner: Annotated[
        Corner,
        describe_setting(
            "Kind of corner",
            "Whether the probe comes from outside the workpiece or into a hollow.",
            "place",
            drawing="corner",
            choices={"outside": "outer corner of a block", "inside": "inner corner of a pocket"},
        ),
    ] = "outside"
    along_x_m: Annotated[
        Length,
        describe_setting(
            "Length felt along x",
            "Points are felt up to this distance from the corner along x.",
            "place",
            unit="m",
            drawing="corner",
        ),
    ] = 0.1
    along_y_m: Annotated[
        Length,
        describe_setting(
            "Length felt along y",
            "Points are felt up to this distance from the corner along y.",
            "place",
            unit="m",
            drawing="corner",
        ),
    ] = 0.1
    inset_m: Annotated[
        Length,
        describe_setting(
            "Distance from an edge",
            "No point is felt nearer to an edge than this.",
            "place",
            unit="m",
            drawing="corner",
        ),
    ] = 0.02
    depth_m: Annotated[
        Length,
        describe_setting(
            "Depth below the first face",
            "So far below the first face the side faces are felt.",
            "place",
            unit="m",
            drawing="corner",
        ),
    ] = 0.012
    clear_m: Annotated[
        Length,
        describe_setting(
            "Distance off a face between touches",
            "The tip travels at this distance from a face.",
            "motion",
            unit="m",
        ),
    ] = 0.03
    search_way_m: Annotated[
        float,
        Field(ge=0.0005, le=0.05),
        describe_setting(
            "Way of the search",
            "So far before and behind the expected face the probe looks for it.",
            "motion",
            unit="m",
        ),
    ] = 0.004
    search_speed_m_s: Annotated[
        float,
        Field(gt=0, le=PROBING_CAP_M_S),
        describe_setting("Speed of the search", "How fast the probe looks for a face.", "motion", unit="m/s"),
    ] = PROBING_CAP_M_S
    measure_speed_m_s: Annotated[
        float,
        Field(gt=0, le=PROBING_CAP_M_S),
        describe_setting(
            "Speed of the measured touch", "How fast the touch that counts is made.", "motion", unit="m/s"
        ),
    ] = 0.0005
    repeats: Annotated[
        int,
        Field(ge=1, le=20),
        describe_setting("Touches at each point", "How often each point is felt.", "effort", unit="1"),
    ] = 2
    max_touches: Annotated[int, Field(ge=6, le=14), MAX_TOUCHES] = 12
    room: Annotated[MotionBounds, ROOM] = field(default_factory=MotionBounds)

    @property
    def retreat_m(self) -> float:
        """The distance back from a contact before the tip feels again."""
        return min(0.001, self.search_way_m / 2.0)

    def __post_init__(self) -> None:
        if min(self.along_x_m, self.along_y_m) < 2.0 * self.inset_m:
            raise ValueError("along_x_m and along_y_m must be twice inset_m or more: points would coincide")
        if self.clear_m < 2.0 * self.search_way_m:
            raise ValueError(
                "clear_m must be twice search_way_m or more: the tip has to pass a face that is off"
            )


@dataclass(frozen=True, slots=True)
class FaceSpot:
    """A place where a face is felt: the how manieth of its places."""

    face: FaceName
    number: int  # from 0


def face_places(rules: CornerRules) -> dict[FaceName, tuple[Triple, ...]]:
    """Return where each face is felt, seen from the frame, in the order of use."""
    near, x, y = rules.inset_m, rules.along_x_m, rules.along_y_m
    depth = rules.depth_m if rules.corner == "inside" else -rules.depth_m
    mid_x, mid_y = (near + x) / 2, (near + y) / 2
    top = ((near, near), (x, near), (near, y), (x, y), (mid_x, near), (near, mid_y), (x, mid_y), (mid_x, y))
    return {
        "z": tuple((u, v, 0.0) for u, v in top),
        "y": tuple((u, 0.0, depth) for u in (near, x, (mid_x + x) / 2, (near + mid_x) / 2)),
        "x": tuple((0.0, v, depth) for v in (near, mid_y)),
    }


def check_places(rules: CornerRules) -> dict[FaceName, Triple]:
    """Return where a face is felt once more to check a frame that was found without that point."""
    near, x, y = rules.inset_m, rules.along_x_m, rules.along_y_m
    depth = rules.depth_m if rules.corner == "inside" else -rules.depth_m
    return {
        "z": ((near + x) / 2, (near + y) / 2, 0.0),
        "y": ((near + x) / 2, 0.0, depth),
        "x": (0.0, y, depth),
    }


def first_spots() -> tuple[FaceSpot, ...]:
    """Return the touches that fix a frame: three, two, one."""
    return tuple(FaceSpot(face, number) for face in FACES for number in range(LEAST[face]))
