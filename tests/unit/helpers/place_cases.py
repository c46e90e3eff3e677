"""Places touched, seated or seen by the arm of the hidden world, before a loss and after it."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.geometry import log_rotation
from cellcal.calibration.mastering.counts import PlaceCapture, RecoveryKit
from cellcal.calibration.mastering.place_recovery import recover_from_places
from tests.unit.helpers.recovery_cases import healthy_record
from tests.unit.helpers.wire_world import COUNTS_PER_TURN, WireWorld

TIP = np.array([0.045, 0.020, 0.150])
SIGMA_M, SIGMA_RAD = 1e-4, 3e-4


def draw_postures(count, seed=0):
    """Return postures in front of the arm, wrist well bent."""
    rng = np.random.default_rng([seed, 9])
    middle = np.array([0.0, 0.3, -0.1, 0.2, -1.0, 0.3])
    return middle + rng.uniform(-1, 1, (count, 6)) * np.array([0.9, 0.35, 0.4, 0.9, 0.5, 1.4])


class PlaceWorld(WireWorld):
    """The same arm with a tip, a seat and an instrument."""

    def flange_pose(self, joints):
        *_, flange = self.link_frames(self.sagged_joints(np.atleast_2d(joints)))
        return flange[0]

    def tip_position(self, joints, tip):
        frame = self.flange_pose(joints)
        return frame[:3, :3] @ tip + frame[:3, 3]

    def reach_target(self, start, target, found):
        """Return joints near ``start`` at which ``found(joints)`` is ``target``, by Newton steps."""
        joints = np.array(start, dtype=float)
        for _ in range(12):
            by = np.array([(found(joints + 1e-6 * e) - found(joints - 1e-6 * e)) / 2e-6 for e in np.eye(6)]).T
            joints = joints + np.linalg.lstsq(by, target - found(joints), rcond=None)[0]
        return joints


@dataclass
class PlaceLoss:
    """A robot with lost counts and a kit of places; ``kind`` says of what."""

    world: PlaceWorld
    record: object
    kit: RecoveryKit
    true_turns: np.ndarray
    provisional: tuple
    again: dict

    def recover_turns(self, numbers, **options):
        captures = [self.again[k] for k in numbers]
        return recover_from_places(
            self.record, self.kit, captures, provisional_turns=self.provisional, **options
        )


def lose_places(seed, count=8, *, kind="point", fractions=None, crash=None, away_rad=0.05):
    """Record places with a healthy arm, lose turns, and visit every place again from about the same side."""
    rng = np.random.default_rng([seed, 3])
    world = PlaceWorld(seed, crash=crash)
    record = healthy_record(world)
    tip = TIP + rng.normal(0, 0.0005, 3)
    at = draw_postures(count, seed)
    homes = [world.flange_pose(q)[:3, :3] if kind == "seat" else None for q in at]
    targets = [_tip_and_turn(world, q, tip, home) for q, home in zip(at, homes, strict=True)]
    places = tuple(_capture_place(world, q, k, kind, np.zeros(6)) for k, q in enumerate(at))
    kit = RecoveryKit(tuple(TIP.tolist()), places)
    world.next_day()
    turns = rng.integers(-40, 41, 6) + (np.zeros(6) if fractions is None else np.asarray(fractions))
    provisional = tuple(int(t) for t in np.rint(turns) + rng.integers(-2, 3, 6))
    again = {}
    for k, q in enumerate(at):
        noise = rng.normal(0, SIGMA_M, 3)
        goal = targets[k] + (np.append(noise, rng.normal(0, SIGMA_RAD, 3)) if kind == "seat" else noise)
        start = q + (0 if kind == "seat" else rng.uniform(-away_rad, away_rad, 6))
        joints = world.reach_target(start, goal, lambda j, home=homes[k]: _tip_and_turn(world, j, tip, home))
        again[k] = _capture_place(world, joints, k, kind, turns)
    return PlaceLoss(world, record, kit, turns, provisional, again)


def _tip_and_turn(world, joints, tip, home):
    """Return the tip, and for a seat the rotation vector from where the seat holds the flange."""
    place = world.tip_position(joints, tip)
    if home is None:
        return place
    return np.append(place, log_rotation(world.flange_pose(joints)[:3, :3] @ home.T))


def _capture_place(world, joints, place, kind, turns):
    counts = np.rint(world.encoder_counts(joints[None])[0] - COUNTS_PER_TURN * turns).astype(int)
    sigma_rad = SIGMA_RAD if kind == "seat" else 0.0
    return PlaceCapture(kind, place, tuple(counts.tolist()), SIGMA_M, sigma_rad, label=f"place {place + 1}")
