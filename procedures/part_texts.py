"""What settings are called whose classes stand in the mathematics, which knows nothing of pages or schemas."""

from collections.abc import Mapping
from typing import Any

from cellcal.procedures.setting_texts import RADIUS, SHAPE_NAME, describe_setting

PART_TEXTS: Mapping[str, Mapping[str, Any]] = {
    "LinkCapsule": {
        "name": SHAPE_NAME,
        "link": describe_setting(
            "Link that carries it",
            "0 is the base; each next one moves with the joint of the same number.",
            "shapes",
            unit="1",
        ),
        "start_m": describe_setting(
            "Start of the bar",
            "One end of the bar's axis in the link's frame.",
            "shapes",
            unit="m",
            drawing="tip",
        ),
        "end_m": describe_setting(
            "End of the bar",
            "The other end of the bar's axis in the link's frame.",
            "shapes",
            unit="m",
            drawing="tip",
        ),
        "radius_m": RADIUS,
    },
    "SphereObstacle": {
        "name": SHAPE_NAME,
        "centre_in_base_m": describe_setting(
            "Middle of the ball",
            "Where the middle is in the robot's base.",
            "shapes",
            unit="m",
            drawing="box",
        ),
        "radius_m": RADIUS,
    },
    "PlaneObstacle": {
        "name": SHAPE_NAME,
        "point_in_base_m": describe_setting(
            "A point on the face",
            "Any point of the face in the robot's base.",
            "shapes",
            unit="m",
            drawing="frame",
        ),
        "normal_in_base": describe_setting(
            "Direction away from the face",
            "Points to the free side; up is 0, 0, 1.",
            "shapes",
            unit="1",
            drawing="frame",
        ),
    },
    "TagPath": {
        "source": describe_setting("Where the tags come from", "The file, or what the points are.", "place"),
        "positions_m": describe_setting("Places", "x, y and z of every tag.", "place", unit="m"),
        "names": describe_setting("Names of the tags", "Empty: tags are told apart by their order.", "place"),
        "quaternions": describe_setting(
            "Directions of the tags", "w, x, y, z of every tag; empty: places only.", "place", unit="1"
        ),
        "joints_rad": describe_setting(
            "Joint angles of the tags",
            "Angles of all axes at every tag; empty: not known.",
            "place",
            unit="rad",
        ),
    },
}
