"""Names, titles and versions of all procedures, in the order of lists; read without loading any of them.

The definitions are in `catalogue`, which loads all of the mathematics; a test compares both.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ProcedureEntry:
    """The entry of one procedure in a list."""

    name: str
    title: str
    version: int


CATALOGUE_INDEX = (
    ProcedureEntry("mastering_record", "Mastering record", 4),
    ProcedureEntry("mastering_recovery", "Mastering recovery", 9),
    ProcedureEntry("mastering_undo", "Undo of a written mastering", 1),
    ProcedureEntry("position_record", "Position record of an ABB, Yaskawa or KUKA", 1),
    ProcedureEntry("position_cure", "Bring a lost position back at the pendant", 2),
    ProcedureEntry("six_point_tcp", "Tool frame from six points", 3),
    ProcedureEntry("three_point_frame", "User frame from three points", 3),
    ProcedureEntry("probed_frame", "User frame from a corner felt by a touch probe", 1),
    ProcedureEntry("frame_offset", "Offset of a user frame after the workpiece moved", 3),
    ProcedureEntry("end_effector_points", "Tool frame from points on the end-effector", 4),
    ProcedureEntry("fixture_alignment", "Fixture alignment with the draw-wire", 5),
    ProcedureEntry("base_to_base", "Robot bases through one fixture", 2),
    ProcedureEntry("robot_calibration", "Robot calibration with draw-wire or tracker", 4),
    ProcedureEntry("drift_check", "Drift check against the reference of a healthy robot", 3),
    ProcedureEntry("accuracy_check", "Accuracy and repeatability following ISO 9283", 3),
    ProcedureEntry("simulation_cell", "Simulated cell from tag points", 1),
)
