"""Points of the end-effector: how hook or target gets to them, and what shape they must have."""

from cellcal.calibration.message import make_message
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
            make_message(
                "Put the tracker's target into point {number} of the end-effector (x {x:.1f}, y {y:.1f}, "
                "z {z:.1f} mm from the tip). The tracker must see it; the robot moves next.",
                number=number,
                x=x,
                y=y,
                z=z,
            ),
        )
    return Instruction(
        f"hook_wire_{number}",
        make_message(
            "Hang the wire's hook into point {number} of the end-effector (x {x:.1f}, y {y:.1f}, z "
            "{z:.1f} mm from the tip). Nothing may touch the wire; the robot moves next.",
            number=number,
            x=x,
            y=y,
            z=z,
        ),
    )


def bad_shape_error(placed: PlacedPoints | None, evidence: object) -> RefusalError | None:
    """Return why points that were found cannot be those of the drawing; None where they can."""
    if placed is None or placed.is_consistent():
        return None
    i, j = placed.worst_pair
    return RefusalError(
        make_message(
            "points {i} and {j} of the end-effector were found {worst_gap_mm:.2f} mm {detail} each "
            "other than on the drawing ({worst_deviation:.1f} deviations)",
            i=i + 1,
            j=j + 1,
            worst_gap_mm=abs(placed.worst_gap_m) * 1000.0,
            detail="further from" if placed.worst_gap_m > 0 else "nearer to",
            worst_deviation=placed.worst_deviation,
        ),
        code="procedure.wrong_shape",
        remedy="See that the points were measured in the order of the drawing, and that nothing is bent.",
        evidence=evidence,
    )
