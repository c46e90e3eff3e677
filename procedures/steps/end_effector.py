"""Points of the end-effector: how hook or target gets to them, and what shape they must have."""

from cellcal.calibration.points.fixture import PlacedPoints, Triple
from cellcal.drivers.interfaces import Instruction
from cellcal.procedures.run import RefusalError

BACK = {
    "wire": Instruction(
        "hook_wire_back",
        "Hang the wire's hook back into its place on the flange; the wire's housing stays as it is. Nothing may "
        "touch the wire; the robot moves next.",
    ),
    "tracker": Instruction(
        "target_back",
        "Put the tracker's target back into its place on the flange; the tracker stays where it is. The robot moves "
        "next.",
    ),
}


def point_instruction(method: str, number: int, point_m: Triple) -> Instruction:
    """Return what a person does so that a point of the end-effector can be measured."""
    x, y, z = (value * 1e3 for value in point_m)
    if method == "tracker":
        return Instruction(
            f"target_to_point_{number}",
            f"Put the tracker's target into point {number} of the end-effector (x {x:.1f}, y {y:.1f}, z {z:.1f} mm "
            "from the tip). The tracker must see it; the robot moves next.",
        )
    return Instruction(
        f"hook_wire_{number}",
        f"Hang the wire's hook into point {number} of the end-effector (x {x:.1f}, y {y:.1f}, z {z:.1f} mm from the "
        "tip). Nothing may touch the wire; the robot moves next.",
    )


def bad_shape_error(placed: PlacedPoints | None, evidence: object) -> RefusalError | None:
    """Return why points that were found cannot be those of the drawing; None where they can."""
    if placed is None or placed.is_consistent():
        return None
    i, j = placed.worst_pair
    return RefusalError(
        f"points {i + 1} and {j + 1} of the end-effector were found {abs(placed.worst_gap_m) * 1e3:.2f} mm "
        f"{'further from' if placed.worst_gap_m > 0 else 'nearer to'} each other than on the drawing "
        f"({placed.worst_deviation:.1f} deviations)",
        code="procedure.wrong_shape",
        remedy="See that the points were measured in the order of the drawing, and that nothing is bent.",
        evidence=evidence,
    )
