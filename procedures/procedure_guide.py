"""When to use which procedure, how long it usually takes, and how to get what a cell lacks for it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Intention = Literal["lost", "tool", "work", "accurate", "check"]
INTENTIONS: Mapping[Intention, str] = {
    "lost": "The robot lost its position",
    "tool": "The tool is new or bent",
    "work": "A fixture or workpiece was moved",
    "accurate": "Make the robot accurate",
    "check": "Check the robot",
}


@dataclass(frozen=True, slots=True)
class GuideEntry:
    """The text that a person reads before choosing a procedure."""

    intention: Intention
    when: str
    minutes: tuple[int, int]  # usually, from start to certificate, with a person at hand
    uses: str  # what a person has at hand for it


GUIDE: Mapping[str, GuideEntry] = {
    "mastering_recovery": GuideEntry(
        "lost",
        "After an empty encoder battery, an exchanged motor or an alarm about the position: finds the lost zero "
        "again.",
        (10, 30),
        "the draw-wire, or the places of the record",
    ),
    "mastering_record": GuideEntry(
        "lost",
        "While the robot is healthy: takes the record from which a lost position is found again later.",
        (10, 25),
        "the draw-wire, or places to touch",
    ),
    "position_cure": GuideEntry(
        "lost",
        "An ABB, Yaskawa or KUKA lost its position: leads through the work at the pendant, axis by axis, and proves "
        "by measurement that every axis is right.",
        (20, 60),
        "the pendant and the draw-wire",
    ),
    "position_record": GuideEntry(
        "lost",
        "While an ABB, Yaskawa or KUKA is healthy: takes the record by which a position brought back at the "
        "pendant is proved later.",
        (10, 25),
        "the draw-wire",
    ),
    "mastering_undo": GuideEntry(
        "lost",
        "When a mastering was written that should not have been: puts back the one before.",
        (2, 5),
        "nothing but the controller",
    ),
    "six_point_tcp": GuideEntry(
        "tool",
        "A tool with a tip was mounted, exchanged or bent: finds the tip by touching a fixed pin from several sides.",
        (8, 15),
        "a fixed pointed pin",
    ),
    "end_effector_points": GuideEntry(
        "tool",
        "A tool without a tip, or one that must be exact: finds it with the draw-wire at points of the end-effector.",
        (15, 30),
        "the draw-wire",
    ),
    "three_point_frame": GuideEntry(
        "work",
        "A new workpiece or table: finds its user frame by touching origin, x and surface with a pointer.",
        (5, 10),
        "a pointer whose tip is known",
    ),
    "frame_offset": GuideEntry(
        "work",
        "The workpiece was clamped anew or moved: finds by how much, from points that were known before.",
        (5, 10),
        "a pointer whose tip is known",
    ),
    "probed_frame": GuideEntry(
        "work",
        "A workpiece with a corner and a robot with a touch probe: the robot feels the corner by itself.",
        (5, 15),
        "a touch probe",
    ),
    "fixture_alignment": GuideEntry(
        "work",
        "A fixture was set up or moved: finds with the draw-wire where it stands from the robot.",
        (20, 40),
        "the draw-wire",
    ),
    "base_to_base": GuideEntry(
        "work",
        "Several robots work at one fixture: tells where their bases stand from each other.",
        (2, 5),
        "nothing: alignments that were made before",
    ),
    "robot_calibration": GuideEntry(
        "accurate",
        "Programs from a simulation, or points that miss: finds the arm's own errors so that they can be "
        "compensated.",
        (30, 90),
        "the draw-wire or a tracker",
    ),
    "simulation_cell": GuideEntry(
        "accurate",
        "The simulation does not fit the real cell: moves its robot, base or workpiece to where they really are.",
        (5, 10),
        "two files with the same points",
    ),
    "drift_check": GuideEntry(
        "check",
        "Every few weeks, or after a bump: tells in a few poses whether the robot is still as it was.",
        (5, 10),
        "the draw-wire or a tracker",
    ),
    "accuracy_check": GuideEntry(
        "check",
        "For acceptance or a customer: measures accuracy and repeatability following ISO 9283.",
        (20, 60),
        "a tracker, or the draw-wire",
    ),
}

NEED_REMEDIES: Mapping[str, str] = {
    "moves_joints": "Choose a robot whose controller takes moves over the network, or let a person move it: "
    "motion = observe in the cell file.",
    "tells_flange_pose": "Choose a link of the maker's own for this robot: without the flange pose its joints cannot "
    "be compared with its model.",
    "commanded": "An engineer allows it in the cell file.",
    "writes_mastering": "This connection does not open it. On a FANUC, set up the registers of its HMI option "
    "(fanuc_hmi.md of the set-up pages); on any other controller a person brings a lost position back at the "
    "pendant, as its maker says.",
    "writes_tool_frame": "Write the result on the pendant by hand, or connect the controller's tool frames.",
    "writes_user_frame": "Write the result on the pendant by hand, or connect the controller's user frames.",
    "gauge": "Connect a draw-wire and enter it in the cell file.",
    "probe": "Mount a touch probe and enter it in the cell file.",
    "dial": "Mount a dial gauge and enter it in the cell file.",
    "model": "An engineer enters the robot's model in the cell file.",
    "gauge_setup": "Measure with a tape where the draw-wire stands and enter it in the cell file.",
    "record": "Take a mastering record while the robot is healthy; one that is lost without a record is first "
    "mastered at the pendant, by its marks or pins.",
    "position_cure": "Use “Mastering recovery” where the controller opens its mastering; else the maker's manual.",
    "drive_data": "Enter the gear ratios of the data sheet in the cell file, as the example cell of this controller "
    "shows.",
    "position_record": "Take a position record while the robot is healthy; one that is lost without a record is "
    "first brought back at the pendant, as its maker says.",
    "backup": "There is nothing to put back: no run has written a mastering yet.",
    "evidence": "Connect a draw-wire, touch probe or tracker, or take a mastering record with touched places.",
    "tracker": "Connect a tracker or another instrument that measures points.",
    "sees_the_flange": "Connect a draw-wire or a tracker and enter it in the cell file.",
    "tracker_setup": "Measure where the target sits on the flange and enter it in the cell file.",
    "measures_poses": "Connect an instrument that measures poses.",
}
