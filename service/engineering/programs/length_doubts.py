"""Whether positions of a project look as if they were written in metres, where millimetres are read."""

from cellcal.calibration.message import make_message
from cellcal.service.engineering.programs.project_poses import PoseTable
from cellcal.service.engineering.programs.project_tables import ProjectTables

_LARGEST_MM = 4.0  # no arm reaches farther in metres; a frame or tip that near to its origin is rare


def length_doubts(tables: ProjectTables, where: str) -> tuple[str, ...]:
    """Return a sentence for each tool and frame that is nearer to its origin than tools and frames are."""
    poses: dict[str, PoseTable] = {f"[frames.{name}]": frame for name, frame in tables.frames.items()}
    for kind, tools in (
        ("tools", tables.tools),
        ("standing_tools", tables.standing_tools),
        ("held_work", tables.held_work),
    ):
        for name, tool in tools.items():
            poses |= {f"[{kind}.{name}.entered]": tool.entered, f"[{kind}.{name}.real]": tool.real}
    return tuple(
        make_message(
            "{where}: {heading}: the position {position} is less than {limit:g} mm from the origin; position_mm "
            "takes millimetres: if these are metres, multiply them by 1000",
            where=where,
            heading=heading,
            position=", ".join(f"{value:g}" for value in pose.position_mm),
            limit=_LARGEST_MM,
        )
        for heading, pose in poses.items()
        if pose.position_mm is not None and 0.0 < max(map(abs, pose.position_mm)) < _LARGEST_MM
    )
