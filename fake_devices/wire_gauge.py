"""A draw-wire: how long it really is, and what its encoder makes of that.

Imitates
    A 3 m string-pull gauge of the better class, hooked to a robot's flange.
Source
    Data sheets: POSITAL LD0 (0.01 % of full scale), Kübler and SIKO draw-wires for the linearity classes;
    the exit guide's effect is plain geometry: a wire bent by phi around a lip of radius r is r (phi - sin
    phi) longer.
Modelled
    Where the wire really leaves and where it is really hooked, exit lip, scale, zero, linearity over the
    drum, noise of every sample, slack, snap, a slipped hook, single outliers, both ends of the range; an exit moved
    to a fixture's seats and a hook moved to an end-effector's holes, by hand.
Not modelled
    Wire sag and stretch, the wire touching the robot, speed limits of the drum, temperature.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cellcal.fake_devices.arm import SimulatedArm
from cellcal.fake_devices.fixture import own_base, own_flange
from cellcal.fake_devices.kinematics import Array, invert_pose, transform_point
from cellcal.fake_devices.world import World

DRUM_M = 0.315  # one turn of the drum
_AIM_IN_BASE_M = (0.75, 0.0, 0.55)


class WireGauge:
    """One wire between a fixed exit and a robot's hook."""

    def __init__(self, world: World, table: Mapping[str, Any]) -> None:
        self.name = str(table["name"])
        self.range_m = float(table.get("range_m", 3.0))
        self.robot = str(table.get("robot", "")) or next(iter(world.arms), "")
        self._arm: SimulatedArm | None = world.arms.get(self.robot)
        rng = world.make_rng(self.name, "wire")
        amount = 1.0 if world.hidden else 0.0
        anchor = np.array(table.get("anchor_in_base_mm", (900.0, -700.0, -450.0))) * 1e-3
        hook = np.array(table.get("hook_in_flange_mm", (60.0, 50.0, 120.0))) * 1e-3
        sigma_m = float(table.get("sigma_m", 2e-4))
        anchor_sigma_m = float(table.get("anchor_sigma_mm", 10.0)) * 1e-3
        hook_sigma_m = float(table.get("hook_sigma_mm", 2.0)) * 1e-3
        self.anchor_in_base_m = anchor + amount * _draw_displacement(rng, anchor_sigma_m)
        self.hook_in_flange_m = hook + amount * _draw_displacement(rng, hook_sigma_m)
        world.hooks_in_flange_m.setdefault(self.robot, self.hook_in_flange_m)
        self._world, self._home = world, (self.anchor_in_base_m, self.hook_in_flange_m)
        aim_mm = table.get("mouth_at_mm")
        self._aim_m = _AIM_IN_BASE_M if aim_mm is None else tuple(float(value) * 1e-3 for value in aim_mm)
        self._look_at(self._aim_m)
        self.exit_radius_m = amount * float(rng.uniform(1.0e-3, 2.0e-3))
        self.scale_error = amount * float(rng.normal()) * 1e-4
        self.zero_m = amount * float(rng.normal()) * 2e-3
        self._waves_m = amount * rng.uniform(0.3, 1.0, 3) * np.array([0.5, 0.3, 0.4]) * sigma_m
        self._phases_rad = rng.uniform(0.0, 2.0 * np.pi, 3)
        self._noise_m = amount * 0.5 * sigma_m
        self._noise = world.make_rng(self.name, "noise")
        self.slipped_m = 0.0
        self._outlier_m, self._outliers_left = 0.0, 0
        self._slack_at_m: float | None = None
        self.snapped = False

    # truth

    def hook_in_base_m(self) -> Array:
        """Return where the hook is now."""
        flange = np.eye(4) if self._arm is None else self._arm.base_flange()
        return transform_point(flange, self.hook_in_flange_m)

    def true_length_m(self) -> float:
        """Return the length of wire from the exit's mouth to the hook."""
        way = self.hook_in_base_m() - self.anchor_in_base_m
        along = float(way @ self._exit_axis)
        across = float(np.linalg.norm(way - along * self._exit_axis))
        radius = self.exit_radius_m
        straight = float(np.sqrt(max(along**2 + (across - radius) ** 2 - radius**2, 0.0)))
        bend = np.arctan2(across - radius, along) + np.arctan2(radius, straight)
        return straight + radius * max(float(bend), 0.0)

    def exact_reading_m(self) -> float:
        """Return what the drum shows without noise, outliers and ends of the range."""
        length = self.true_length_m()
        turns = 2.0 * np.pi * np.array([1.0, 2.0, DRUM_M / self.range_m]) * length / DRUM_M
        linearity = float(self._waves_m @ np.sin(turns + self._phases_rad))
        return length * (1.0 + self.scale_error) + self.zero_m + linearity + self.slipped_m

    def fixture_in_base(self) -> Array | None:
        """Return the fixture seen from the base that the arm's first axis defines; None without one."""
        if self._world.fixture is None or self._arm is None:
            return None
        return invert_pose(own_base(self._arm)) @ self._world.fixture.in_base(self.robot)

    def tool_in_flange(self) -> Array | None:
        """Return the tool seen from the flange that the arm's last axis defines; None without one."""
        if self._world.end_effector is None or self._arm is None:
            return None
        return own_flange(self._arm) @ self._world.end_effector.flange_tool

    # reading

    def read_m(self) -> tuple[float, bool]:
        """Return one sample and whether it lies inside the range; beyond an end the drum stands there."""
        length = self._drum_m()
        if self._outliers_left > 0:
            self._outliers_left -= 1
            length += self._outlier_m
        length += float(self._noise.normal()) * self._noise_m
        inside = 0.0 <= length <= self.range_m
        return min(max(length, 0.0), self.range_m), inside

    def _drum_m(self) -> float:
        if self.snapped:
            return 5.0 * self._noise_m  # wound up, resting at its stop
        exact = self.exact_reading_m()
        if self._slack_at_m is None:
            return exact
        self._slack_at_m = max(self._slack_at_m, exact)  # a caught wire is still pulled out, never wound up
        return self._slack_at_m

    # what happens to it

    def mount_exit(self, point: int, mouth_at_m: Sequence[float] = _AIM_IN_BASE_M) -> None:
        """Put the base adaptor on an alignment point of the fixture, the wire's mouth towards a place."""
        if self._world.fixture is None:
            raise ValueError("this cell has no fixture")
        self.anchor_in_base_m = self._world.fixture.seat_in_base(self.robot, point)
        self._look_at(mouth_at_m)

    def hook_to(self, target: int) -> None:
        """Hang the hook into a target point of the end-effector."""
        if self._world.end_effector is None:
            raise ValueError("this cell has no end-effector with targets")
        self.hook_in_flange_m = self._world.end_effector.hole_in_flange(target)

    def go_home(self) -> None:
        """Put exit and hook back where the cell file has them."""
        self.anchor_in_base_m, self.hook_in_flange_m = self._home
        self._look_at(self._aim_m)

    def _look_at(self, place_m: Sequence[float]) -> None:
        ahead = np.array(place_m, dtype=float) - self.anchor_in_base_m
        self._exit_axis = ahead / np.linalg.norm(ahead)

    def let_catch(self) -> None:
        """Let the wire catch on something: it no longer winds up."""
        self._slack_at_m = self.exact_reading_m()

    def let_go(self) -> None:
        """Let the wire go; it winds up completely."""
        self.snapped = True

    def restore_hook(self) -> None:
        """Put the hook back where it was."""
        self.snapped, self._slack_at_m = False, None
        self.slipped_m, self._outliers_left = 0.0, 0

    def lengthen_readings(self, metres: float) -> None:
        """Lengthen every reading from now on: a hook that sits elsewhere, a drum that has slipped."""
        self.slipped_m += metres

    def corrupt_next(self, metres: float, count: int) -> None:
        """Put the next readings off."""
        self._outlier_m, self._outliers_left = metres, count


def _draw_displacement(rng: np.random.Generator, sigma_m: float) -> Array:
    """Return a displacement, at most two sigma in every direction, as by a tape measure."""
    return np.asarray(np.clip(rng.normal(size=3), -2.0, 2.0) * sigma_m)
