"""A FANUC-like arm on a draw-wire with hidden errors, written apart from the mathematics under test.

Hidden: link errors, joint zero errors, joint compliance under gravity, gear harmonics, backlash, linearity
and exit lip of the wire, another day's hook. Rows of the arm are those of the maker's published form.
"""

import numpy as np

RATIOS = np.array([121.0, 153.0, 160.5, 80.25, 80.0, 50.0])
COUNTS_PER_TURN = 2**19
ANCHOR, HOOK = np.array([0.9, -0.7, -0.45]), np.array([0.06, 0.05, 0.12])
_ROWS = np.array(
    [
        [0.0, 0.0, 0.150, -90.0, 0.0],
        [-90.0, 0.0, 0.600, 180.0, 0.0],
        [0.0, 0.0, 0.100, -90.0, 0.0],
        [0.0, -0.615, 0.0, 90.0, 0.0],
        [0.0, 0.0, 0.0, -90.0, 0.0],
        [0.0, -0.100, 0.0, 180.0, 0.0],
    ]
)
_UNIT = np.deg2rad([1.0, 0, 0, 1.0, 1.0]) + np.array([0, 1.0, 1.0, 0, 0])


def interaction_matrix():
    matrix = np.diag(np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0]) * (2 * np.pi / COUNTS_PER_TURN / RATIOS))
    per_count = 2 * np.pi / COUNTS_PER_TURN
    matrix[4, 3], matrix[5, 3], matrix[5, 4] = per_count / 160.0, -per_count / 100.0, per_count / 100.0
    return matrix


class WireWorld:
    """One robot, one wire, one seed."""

    def __init__(self, seed, *, crash=None, noise_m=0.0001, coupling_error=0.0):
        rng = np.random.default_rng([seed, 77])
        self.rng, self.noise_m = rng, noise_m
        self.rows = _ROWS * _UNIT
        # (theta, d, a, alpha, beta): the parallel axes 2 and 3 have no d of their own
        self.rows = self.rows + rng.normal(0, 1, (6, 5)) * np.deg2rad([0.02, 0, 0, 0.02, 0.01])
        self.rows[:, 1:3] += rng.normal(0, 0.0003, (6, 2))
        self.anchor = ANCHOR + rng.normal(0, 0.005, 3)
        self.hook = HOOK + rng.normal(0, 0.001, 3)
        self.zero, self.scale = rng.normal(0, 0.003), 1 + rng.normal(0, 0.0004)
        self.wave = (rng.uniform(0.0001, 0.0003), rng.uniform(0.8, 2.5), rng.uniform(0, 6))
        self.exit_radius = 0.005
        self.exit_axis = np.array([-0.6, 0.55, 0.6]) / np.linalg.norm([-0.6, 0.55, 0.6])
        self.give = rng.uniform(0.4, 1.0, 6) * np.array([0, 1.4e-6, 1.6e-6, 0, 4e-6, 0])  # rad / Nm
        self.ripple = np.deg2rad(rng.uniform(0.002, 0.008, (2, 6)))
        self.phase = rng.uniform(0, 6, (2, 6))
        self.zero_counts = rng.integers(-(2**22), 2**22, 6)
        self.crash = crash or {}
        wrong = 1.0 + coupling_error * rng.normal(size=(6, 6)) * (1.0 - np.eye(6))
        self.per_radian = np.linalg.inv(interaction_matrix() * wrong)

    def next_day(self):
        self.hook = self.hook + self.rng.normal(0, 0.00005, 3)
        self.zero += self.rng.normal(0, 0.00005)
        for row, errors in self.crash.items():
            self.rows[row] += errors

    def link_frames(self, joints):
        angles = joints + np.array([0, 0, 1, 0, 0, 0]) * joints[:, 1:2] + self.rows[:, 0]
        frame = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        for j in range(6):
            frame = frame @ _axis_rotation(angles[:, j], 2) @ _link_matrix(self.rows[j])
            yield frame

    def potential_energy(self, joints):
        _, upper, fore, _, _, flange = self.link_frames(joints)
        return 9.81 * (60 * upper[:, 2, 3] + 40 * fore[:, 2, 3] + 12 * flange[:, 2, 3])

    def sagged_joints(self, joints):
        torque = np.zeros_like(joints)
        for j in range(6):
            step = np.eye(6)[j] * 1e-4
            torque[:, j] = (
                -(self.potential_energy(joints + step) - self.potential_energy(joints - step)) / 2e-4
            )
        motor = joints * RATIOS
        ripple = self.ripple[0] * np.sin(motor + self.phase[0]) + self.ripple[1] * np.sin(
            2 * joints + self.phase[1]
        )
        return joints + self.give * torque + ripple

    def measure_lengths(self, joints, *, either_flank=False):
        joints = np.atleast_2d(joints)
        loose = 0.02 * self.rng.integers(0, 2, joints.shape) if either_flank else 0.0
        real = self.sagged_joints(joints) + np.deg2rad(self.rng.normal(0, 0.001, joints.shape) + loose)
        *_, flange = self.link_frames(real)
        away = flange[:, :3, :3] @ self.hook + flange[:, :3, 3] - self.anchor
        distance = np.linalg.norm(away, axis=1)
        bend = np.arccos(np.clip(away @ self.exit_axis / distance, -1, 1))
        path = distance + self.exit_radius * (bend - np.sin(bend))
        height, period, phase = self.wave
        wavy = path + height * np.sin(2 * np.pi * path / period + phase)
        return self.zero + self.scale * wavy + self.rng.normal(0, self.noise_m, len(joints))

    def encoder_counts(self, joints):
        return np.rint(joints @ self.per_radian.T + self.zero_counts).astype(int)


def _axis_rotation(angle, axis):
    matrix = np.zeros((len(angle), 4, 4))
    matrix[:] = np.eye(4)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[:, i, i] = matrix[:, j, j] = np.cos(angle)
    matrix[:, j, i] = np.sin(angle)
    matrix[:, i, j] = -np.sin(angle)
    return matrix


def _link_matrix(row):
    shift = np.eye(4)
    shift[0, 3], shift[2, 3] = row[2], row[1]
    return shift @ _axis_rotation(row[3:4], 0)[0] @ _axis_rotation(row[4:5], 1)[0]
