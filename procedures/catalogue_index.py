"""Names, titles and versions of all procedures, in the order of lists; read without loading any of them.

The definitions are in `catalogue`, which loads all of the mathematics; a test compares both.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """What a list shows of one procedure."""

    name: str
    title: str
    version: int


CATALOGUE_INDEX = (
    CatalogueEntry("mastering_record", "Mastering record", 4),
    CatalogueEntry("mastering_recovery", "Mastering recovery", 8),
    CatalogueEntry("mastering_undo", "Undo of a written mastering", 1),
    CatalogueEntry("six_point_tcp", "Tool frame from six points", 3),
    CatalogueEntry("three_point_frame", "User frame from three points", 3),
    CatalogueEntry("probed_frame", "User frame from a corner felt by a touch probe", 1),
    CatalogueEntry("frame_offset", "Offset of a user frame after the workpiece moved", 3),
    CatalogueEntry("end_effector_points", "Tool frame from points on the end-effector", 4),
    CatalogueEntry("fixture_alignment", "Fixture alignment with the draw-wire", 5),
    CatalogueEntry("base_to_base", "Robot bases through one fixture", 2),
    CatalogueEntry("robot_calibration", "Robot calibration with draw-wire or tracker", 4),
    CatalogueEntry("drift_check", "Drift check against the reference of a healthy robot", 3),
    CatalogueEntry("accuracy_check", "Accuracy and repeatability following ISO 9283", 3),
    CatalogueEntry("simulation_cell", "Simulated cell from tag points", 1),
)
