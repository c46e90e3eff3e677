"""The truth of a fake cell: one clock, the arms, and what they are hooked to.

Imitates
    The shop floor.
Source
    The [fake] table of a cell file: ``seed`` draws everything hidden, ``time_factor`` sets the clock,
    ``watchdog_factor`` lengthens the watchdogs that run in real time, for a machine that has other work.
Modelled
    Arms by name, each with its own hidden errors; the masterings that can be lost; the true hooks of wires;
    a fixture and an end-effector that a wire can be moved to; artefacts that a probe can touch; marks and a seat;
    how far a tool tip is off when a controller works with a given mastering.
Not modelled
    Collisions between arms, wire and other objects; people.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm, make_generator
from cellcal.fake_devices.arm_models import ArmModel
from cellcal.fake_devices.artefact import Artefact
from cellcal.fake_devices.clock import WorldClock
from cellcal.fake_devices.described_arms import model_of
from cellcal.fake_devices.fixture import FakeEndEffector, FakeFixture
from cellcal.fake_devices.kinematics import Array, transform_point
from cellcal.fake_devices.place_marks import PlaceMarks

_TIP_IN_FLANGE_M = (0.06, 0.05, 0.12)
_CHECK_POSES = 50


class MasteringSource(Protocol):
    """Converter of encoder counts into joint angles."""

    def true_offset_rad(self, counts_at_zero: tuple[int, ...] | None = None) -> Array:
        """Return true minus commanded joints under a mastering; by default the one in use."""
        ...


class World:
    """The true state of the cell, known to the fakes and to the control port only."""

    def __init__(self, seed: int = 1, time_factor: float = 1.0, *, hidden: bool = True) -> None:
        self.seed, self.hidden = seed, hidden
        self.watchdog_factor = 1.0
        self.clock = WorldClock(time_factor)
        self.arms: dict[str, SimulatedArm] = {}
        self.described: Mapping[str, ArmModel] = {}  # by the robot's name in the cell file
        self.masterings: dict[str, MasteringSource] = {}
        self.hooks_in_flange_m: dict[str, Array] = {}
        self.tips_in_flange_m: dict[str, Array] = {}  # of probes, by robot
        self.fixture: FakeFixture | None = None
        self.end_effector: FakeEndEffector | None = None
        self.artefacts: list[Artefact] = []
        self.marks = PlaceMarks(self)
        self.shared: dict[tuple[str, int], object] = {}  # by address: what several devices are wired to

    def add_arm(self, name: str, model_name: str) -> SimulatedArm:
        """Put up one arm; ``name`` is its robot's name in the cell file."""
        model = model_of(name, model_name, self.described)
        arm = SimulatedArm.from_model(model, self.seed, self.hidden, name=name, clock=self.clock)
        self.arms[name] = arm
        return arm

    def add_fixtures(self, fake: Mapping[str, Any]) -> None:
        """Put up the fixture, the end-effector and the artefacts that the [fake] table describes, if any."""
        if "fixture" in fake:
            self.fixture = FakeFixture(self.seed, self.hidden, fake["fixture"])
        if "end_effector" in fake:
            self.end_effector = FakeEndEffector(self.seed, self.hidden, fake["end_effector"])
        for table in fake.get("artefact", []):
            rng = self.make_rng("artefact", str(table["name"]))
            self.artefacts.append(Artefact(table, rng, 1.0 if self.hidden else 0.0))

    def make_rng(self, *labels: str) -> np.random.Generator:
        """Return the random generator of one named purpose."""
        return make_generator(self.seed, *labels)

    def tcp_error_m(
        self,
        robot: str,
        counts_at_zero: Sequence[int] | None = None,
        poses: Sequence[Sequence[float]] | None = None,
    ) -> Array:
        """Return how far the tip is from where the same commands put it before anything was lost, per pose.

        Both sides without backlash. The tip is the true hook of the arm's wire where there is one.
        """
        arm = self.arms[robot]
        tip = self.hooks_in_flange_m.get(robot, np.array(_TIP_IN_FLANGE_M))
        if poses is None:
            middle, half = (arm.upper_rad + arm.lower_rad) / 2.0, (arm.upper_rad - arm.lower_rad) / 2.0
            shares = np.random.default_rng(7).uniform(-0.6, 0.6, (_CHECK_POSES, middle.size))
            commanded = middle + shares * half
        else:
            commanded = np.atleast_2d(np.array(poses, dtype=float))
        counts = None if counts_at_zero is None else tuple(int(count) for count in counts_at_zero)
        offset = self.masterings[robot].true_offset_rad(counts)
        before = transform_point(arm.flange_at(commanded, as_delivered=True), tip)
        after = transform_point(arm.flange_at(commanded + offset), tip)
        return np.asarray(np.linalg.norm(after - before, axis=1))
