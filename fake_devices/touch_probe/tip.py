"""What a tip on a flange meets: a switching probe's contact and a dial gauge's plunger.

Imitates
    A touch-trigger probe with a ball tip, and a dial gauge with a plunger, each screwed to a robot's flange.
Source
    Makers' descriptions of kinematic (three-legged) probes: the tip gives way by the pretravel before the contact
    opens or closes, a little more along three directions; data sheets of inductive gauges for noise.
Modelled
    Where the tip really is, pretravel with three lobes and scatter, the moment of contact between two looks, a
    switching delay, bounce; the plunger's travel up to its end, its noise and its zero.
Not modelled
    Bending stylus, the force on the arm, probes that trip by acceleration.
"""

import time
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.kinematics import Array, transform_point
from cellcal.fake_devices.world import World

_LOBES = 3
_FAR_M, _NEAR_M = 1e3, 1e-3
_SIGHTS = 64
_SPRING_S = 0.0013


class ProbeTip:
    """A ball on a flange."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._world, self.robot = world, str(table.get("robot", "")) or next(iter(world.arms), "")
        self.arm: SimulatedArm | None = world.arms.get(self.robot)
        rng, amount = world.make_rng(str(table["name"]), "tip"), 1.0 if world.hidden else 0.0
        place = np.array(table.get("tip_in_flange_mm", (0.0, 0.0, 150.0)), dtype=float) * 1e-3
        off = np.clip(rng.normal(size=3), -2.0, 2.0) * float(table.get("tip_sigma_mm", 1.0)) * 1e-3
        self.in_flange_m = place + amount * off
        world.tips_in_flange_m[self.robot] = self.in_flange_m
        axis = np.array(table.get("axis_in_flange", (0.0, 0.0, 1.0)), dtype=float)
        self.axis_in_flange = axis / np.linalg.norm(axis)
        self.radius_m = float(table.get("tip_radius_mm", 1.5)) * 1e-3

    def base_flange(self) -> Array:
        """Return the flange now, (4, 4)."""
        return np.eye(4) if self.arm is None else self.arm.base_flange()

    def shown_joints(self) -> Array:
        """Return the joints that the arm's controller shows now."""
        return np.zeros(6) if self.arm is None else self.arm.controller_joints_rad

    def nearest_artefact(self, base_flange: Array, pushed_in_m: float = 0.0) -> tuple[float, Array]:
        """Return clearance of the ball from the nearest artefact [m] and, near it, the way out."""
        place = self.in_flange_m - pushed_in_m * self.axis_in_flange
        centre = transform_point(base_flange, place)
        around = [thing for thing in self._world.artefacts if thing.robot == self.robot]
        if not around:
            return _FAR_M, self.axis_in_flange
        thing = min(around, key=lambda one: one.clearance_m(centre))
        clearance = thing.clearance_m(centre) - self.radius_m
        if clearance > _NEAR_M:
            return clearance, self.axis_in_flange
        return clearance, base_flange[:3, :3].T @ thing.outward_direction(centre)


class ContactSwitch:
    """A contact with a delay, as electronics see it: its times are real time."""

    def __init__(self, delay_s: float, bounce_s: float) -> None:
        self.delay_s, self.bounce_s = delay_s, bounce_s
        self._changes: deque[tuple[float, bool]] = deque([(-1e9, False)], maxlen=_SIGHTS)

    def note_change(self, real_s: float, closed: bool) -> None:
        """Note a change of the mechanical contact."""
        self._changes.append((real_s, closed))

    def is_closed(
        self, real_s: float, more_delay_s: float = 0.0, bounce: tuple[float, float] | None = None
    ) -> bool:
        """Return what the input terminal sees; for a while after it closed, the contact springs to and fro."""
        springs_s, half_s = bounce or (self.bounce_s, _SPRING_S)
        seen_s = real_s - self.delay_s - more_delay_s
        since_s, closed = next(change for change in reversed(self._changes) if change[0] <= seen_s)
        passed_s = seen_s - since_s
        return closed and (passed_s >= springs_s or int(passed_s / half_s) % 2 == 0)


class ContactProbe:
    """A touch-trigger probe: what it meets, and what its cable says."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self._clock, self.tip = world.clock, ProbeTip(world, table)
        rng, amount = world.make_rng(str(table["name"]), "probe"), 1.0 if world.hidden else 0.0
        spread_s = float(table.get("delay_tolerance_ms", 3.0)) * 1e-3
        delay_s = float(table.get("delay_ms", 6.0)) * 1e-3 + amount * float(rng.uniform(-0.8, 0.8)) * spread_s
        self.switch = ContactSwitch(max(delay_s, 0.0), float(table.get("bounce_ms", 0.0)) * 1e-3)
        self._sigma_m = amount * float(table.get("sigma_mm", 0.002)) * 1e-3
        self.pretravel_m = float(table.get("pretravel_mm", 0.02)) * 1e-3
        self._lobe_phase_rad = float(rng.uniform(0.0, 2.0 * np.pi))
        self._scatter = world.make_rng(str(table["name"]), "scatter")
        self._scatter_m = 0.0
        self._before: tuple[float, float, Array] | None = None
        self._touching = False
        self.deepest_m = 0.0
        self.pressed = False  # by a finger
        self.touched_at_s: float | None = None  # of the real clock
        self.contact_joints_rad: list[float] | None = None

    def update_contact(self) -> None:
        """Look where the tip is; find when it met something, or left it, since the last look."""
        real_s, flange = self._clock.real_now_s(), self.tip.base_flange()
        clearance, outward = self.tip.nearest_artefact(flange)
        beyond = -clearance - self._give_m(outward)  # positive: the contact is made
        joints = self.tip.shown_joints()
        self.deepest_m = max(self.deepest_m, -clearance)
        if (beyond > 0.0 or self.pressed) is not self._touching:
            self._touching = not self._touching
            self._note_change(*self._find_crossing(real_s, beyond, joints))
        self._before = (real_s, beyond, joints)

    def _note_change(self, when_s: float, at: Array) -> None:
        self.switch.note_change(when_s, self._touching)
        if self._touching:
            self.touched_at_s, self.contact_joints_rad = when_s, at.tolist()
        else:
            self._scatter_m = 0.5 * self._sigma_m * float(self._scatter.normal())

    def _find_crossing(self, real_s: float, beyond: float, joints: Array) -> tuple[float, Array]:
        if self._before is None:
            return real_s, joints
        then_s, then_beyond, then_joints = self._before
        if (then_beyond > 0.0) is (beyond > 0.0):  # a finger, not the arm
            return real_s, joints
        share = then_beyond / (then_beyond - beyond)
        return then_s + share * (real_s - then_s), then_joints + share * (joints - then_joints)

    def _give_m(self, outward: Array) -> float:
        side = float(np.arctan2(outward[1], outward[0]))
        lobes = 0.5 * self._sigma_m * float(np.cos(_LOBES * side + self._lobe_phase_rad))
        return self.pretravel_m + lobes + self._scatter_m

    def _monotonic_time(self, real_s: float | None) -> float | None:
        """Return a real time on the clock that all processes of a machine share."""
        return None if real_s is None else time.monotonic() - self._clock.real_now_s() + real_s

    def true_state(self) -> dict[str, Any]:
        """Return what is really so, ready for JSON."""
        clearance, _ = self.tip.nearest_artefact(self.tip.base_flange())
        return {
            "tip_in_flange_m": self.tip.in_flange_m.tolist(),
            "tip_radius_m": self.tip.radius_m,
            "clearance_m": clearance,
            "deepest_m": self.deepest_m,
            "delay_s": self.switch.delay_s,
            "pretravel_m": self.pretravel_m,
            "contact_joints_rad": self.contact_joints_rad,
            "touched_at_s": self._monotonic_time(self.touched_at_s),
        }


class DialPlunger:
    """A dial gauge with an electric output: how far its plunger is pushed in."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self.tip = ProbeTip(world, table)
        amount = 1.0 if world.hidden else 0.0
        self.range_m = float(table["range_mm"]) * 1e-3
        self._noise_m = amount * 0.3 * float(table.get("sigma_mm", 0.01)) * 1e-3
        self._noise = world.make_rng(str(table["name"]), "noise")
        self.by_hand_m = 0.0  # a finger pushes it in so far

    def pushed_in_m(self) -> float:
        """Return how far the plunger is really pushed in; at its end it stands, whatever the arm does."""
        flange, inside = self.tip.base_flange(), 0.0
        for _ in range(200):  # the clearance grows by no more than the way: each step is safe
            lack = -self.tip.nearest_artefact(flange, inside)[0]
            if lack <= 1e-9 or inside >= self.range_m:
                break
            inside += lack
        return min(max(inside, self.by_hand_m), self.range_m)

    def read_m(self) -> float:
        """Return what its electronics put out."""
        return self.pushed_in_m() + float(self._noise.normal()) * self._noise_m

    def true_state(self) -> dict[str, Any]:
        """Return what is really so, ready for JSON."""
        return {
            "tip_in_flange_m": self.tip.in_flange_m.tolist(),
            "tip_radius_m": self.tip.radius_m,
            "clearance_m": self.tip.nearest_artefact(self.tip.base_flange())[0],
            "reading_m": self.pushed_in_m(),
        }
