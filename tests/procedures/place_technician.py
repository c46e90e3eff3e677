"""A technician who brings the ideal arm to places: points to touch, a keyed seat, targets that an instrument sees."""

import re
from dataclasses import dataclass, field

import numpy as np

from cellcal.calibration.geometry import log_rotation
from cellcal.calibration.mastering.counts import MasteringRecord, WireCapture
from cellcal.drivers.interfaces import Condition, Identity, PointReading, Readiness, TrackerCapabilities
from cellcal.procedures.mastering_record import fit_wire, sealed_record
from cellcal.procedures.steps.mastering import read_motors
from tests.procedures.ideal_devices import IdealArm
from tests.procedures.procedure_scenes import ProcedureScene

TIP = (0.045, 0.020, 0.150)
Array = np.ndarray


def draw_postures(count: int) -> Array:
    """Return postures in front of the arm, wrist well bent."""
    middle = np.array([0.0, 0.3, -0.1, 0.2, -1.0, 0.3])
    reach = np.array([0.9, 0.35, 0.4, 0.9, 0.5, 1.4])
    return middle + np.random.default_rng(9).uniform(-1, 1, (count, 6)) * reach


async def record_at_once(made: ProcedureScene) -> MasteringRecord:
    """Return the mastering record of a scene's healthy robot, without the travel."""
    arm, wire = made.arm, made.wire
    here, captures = arm.true_joints, []
    spread = np.random.default_rng(5).uniform(-1, 1, (30, 6)) * np.array([1.2, 0.6, 0.6, 1.5, 1.2, 2.0])
    for k, joints in enumerate(spread + np.array([0.0, 0.2, -0.1, 0.0, -0.4, 0.0])):
        arm.write_program(joints)
        reading = await wire.read_distance()
        captures.append(
            WireCapture(
                await arm.encoder_counts(), reading.value_m, reading.sigma_m, "record", f"pose {k + 1}"
            )
        )
    arm.write_program(here)
    state = await read_motors(made.cell)
    return sealed_record(state, tuple(captures), fit_wire(state, tuple(captures)))


@dataclass
class PlaceTracker:
    """An instrument somewhere in the hall that sees a target on the flange, or in a fixed nest."""

    arm: IdealArm
    station: tuple[Array, Array] = field(default_factory=lambda: (np.eye(3), np.array([2.0, -1.0, 0.3])))
    nest_m: Array | None = None  # where the target sits instead, in the base
    tip_m: tuple[float, float, float] = TIP
    name: str = "tracker"

    @property
    def capabilities(self) -> TrackerCapabilities:
        return TrackerCapabilities(measures_poses=False, range_m=20.0, sigma_m=5e-5)

    async def identify(self) -> Identity:
        return Identity("ideal", "tracker", "T-1", "1.0")

    async def read_condition(self) -> Condition:
        return Condition(Readiness.READY)

    async def measure_point(self) -> PointReading:
        tip = self.arm.model.tip_positions(self.arm.true_joints[None], np.array(self.tip_m))[0]
        place = tip if self.nest_m is None else self.nest_m
        rotation, at = self.station
        x, y, z = (float(v) for v in rotation.T @ (place - at))
        return PointReading((x, y, z), (5e-5,) * 3, 0.0, 1)


class PlaceTechnician:
    """Knows where the places are, and brings the arm there from another posture after every loss of the encoders.

    The same way for the same place otherwise: a run that was interrupted can be compared with one that was not.
    """

    def __init__(
        self, made: ProcedureScene, count: int, kind: str, tracker: PlaceTracker | None = None
    ) -> None:
        self.made, self.kind = made, kind
        self.tip = np.array(TIP)
        self.homes = draw_postures(count + 8)
        self.tracker = tracker
        self.nests = np.array([[1.5, 0.9, -0.4], [1.4, -1.0, -0.3], [-0.5, 1.1, 0.2], [0.2, -1.2, 0.9]])
        for k in range(count + 8):
            for what in ("point", "seat", "target", "nest"):
                made.technician.does[f"visit_{what}_{k + 1}"] = lambda k=k, what=what: self.visit_place(
                    what, k
                )

    def follow_the_words(self) -> None:
        """Make each mark near where the instruction wants it, once; afterwards it is where it is."""
        self.homes_known: set[int] = set()

    def _read_home(self, what: str, number: int) -> None:
        home_by_number = getattr(self, "homes_known", None)
        found = re.search(
            r"at about (.*?) deg", self.made.technician.read.get(f"visit_{what}_{number + 1}", "")
        )
        if home_by_number is not None and number not in home_by_number and found:
            degrees = [float(word.split()[1]) for word in found[1].split(",")]
            self.homes[number] = np.radians(degrees) + self._rng_for_place(number).uniform(-0.08, 0.08, 6)
            home_by_number.add(number)

    def _rng_for_place(self, number: int) -> np.random.Generator:
        return np.random.default_rng([4, number, self.made.arm.epoch])

    def visit_place(self, what: str, number: int) -> None:
        """Bring the tip where it belongs."""
        self._read_home(what, number)
        arm, model = self.made.arm, self.made.arm.model
        if self.tracker is not None:
            self.tracker.nest_m = self.nests[number] if what == "nest" else None
        if what == "nest":
            return
        home = self.homes[number]
        if what == "target":
            arm.write_program(home + self._rng_for_place(number).uniform(-0.05, 0.05, 6))
            return
        frame = model.base_flange(home[None])[0]
        goal = frame[:3, :3] @ np.array(TIP) + frame[:3, 3]
        joints = home + self._rng_for_place(number).uniform(-0.03, 0.03, 6)

        def residual(q: Array) -> Array:
            at = model.base_flange(q[None])[0]
            place = at[:3, :3] @ self.tip + at[:3, 3] - goal
            return np.append(place, log_rotation(at[:3, :3] @ frame[:3, :3].T)) if what == "seat" else place

        for _ in range(8):
            by = np.array(
                [(residual(joints + 1e-6 * e) - residual(joints - 1e-6 * e)) / 2e-6 for e in np.eye(6)]
            ).T
            joints = joints - np.linalg.lstsq(by, residual(joints), rcond=None)[0]
        arm.write_program(joints)
