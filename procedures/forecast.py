"""What a procedure would do and reach, told before a device is touched: the dry run.

A procedure says it in a function ``(spec, Knowledge) -> Forecast`` on its card, pure and without a device.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.mastering.position_record import ArmPositionRecord
from cellcal.calibration.points.alignment import Alignment
from cellcal.drivers.interfaces import Counts, GaugeCapabilities, Joints, TrackerCapabilities
from cellcal.procedures.accuracy_limits import AccuracyClass, is_in_reach
from cellcal.procedures.cell import GaugeSetup, MotionCaps, TrackerSetup
from cellcal.procedures.instruments import Instruments

PERSON_S = 60.0  # what a person takes to bring the arm to a point by hand, or to do as told
ANSWER_S = 5.0
SAMPLE_S = 0.1


@dataclass(frozen=True)
class Knowledge:
    """The facts known of a cell without asking it: the cell file, the journal, the watch's findings."""

    model: RobotModel | None = None
    gauge_setup: GaugeSetup | None = None
    gauge: GaugeCapabilities | None = None
    record: MasteringRecord | None = None
    position_record: ArmPositionRecord | None = None  # where the encoders cannot be read
    last_counts: Counts | None = None
    limits: MotionCaps = field(default_factory=MotionCaps)
    tracker_setup: TrackerSetup | None = None
    tracker: TrackerCapabilities | None = None
    instruments: Instruments = field(default_factory=Instruments)  # what places can be found again with
    alignments: tuple[Alignment, ...] = ()  # of every robot with every fixture, oldest first
    drift_references: tuple[DriftReference, ...] = ()  # of this robot, oldest first


@dataclass(frozen=True, slots=True)
class PlannedPose:
    """The pose of a planned measurement."""

    label: str
    joints_rad: Joints


@dataclass(frozen=True, slots=True)
class Prediction:
    """The predicted uncertainty of a quantity, k = 2 where not said otherwise, and each class's limit for it."""

    name: str
    expanded: float
    unit: str
    limits: Mapping[AccuracyClass, float] = field(default_factory=dict)
    sentence: str = ""

    def classes_in_reach(self) -> tuple[AccuracyClass, ...]:
        """Return the classes that may be chosen: their limit is at least three times the predicted U."""
        return tuple(name for name, limit in self.limits.items() if is_in_reach(self.expanded, limit))


@dataclass(frozen=True, slots=True)
class Forecast:
    """A dry run: poses where they are known before measuring, time, predicted uncertainty, and what was assumed."""

    duration_s: float
    poses: tuple[PlannedPose, ...] = ()
    speed_rad_s: float | None = None
    predictions: tuple[Prediction, ...] = ()
    assumed: tuple[str, ...] = ()
    lacks: tuple[str, ...] = ()  # beyond the needs on the card, such as a record
    not_checked: tuple[str, ...] = ()
    planned: Mapping[str, int] = field(default_factory=dict)  # how often a phase of the outline is expected


def missing_wire_setup(knowledge: Knowledge) -> tuple[str, ...]:
    """Return what must be known of a cell before the lengths of a draw-wire can be foretold."""
    lacks = (
        ("a kinematic model", knowledge.model),
        ("a gauge", knowledge.gauge),
        ("where the wire is", knowledge.gauge_setup),
    )
    return tuple(name for name, found in lacks if found is None)
