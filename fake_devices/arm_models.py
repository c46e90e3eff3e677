"""Arms as their makers draw them, for the fake world.

Imitates
    Geometry, limits, speeds, gears and rough masses of the arms a fake cell can hold.
Source
    Universal Robots: the maker's public DH tables. FANUC M-6iB: a1 = 150, a2 = 600 mm and the joint ranges of
    the maker's data sheet; a3 = 100 and d4 = 615 mm are chosen so that the published reach of 1373 mm of the
    wrist centre comes out; FANUC's zero pose (flange X = a1 + d4 + d6, Z = a2 + a3). Gear ratios, masses and
    stiffnesses are illustrative numbers of the right size, not the makers'.
Modelled
    Six turning axes, J2/J3 interaction and the wrist coupling of FANUC arms.
Not modelled
    Closed parallelogram links, balancers.
"""

from dataclasses import dataclass
from math import pi

import numpy as np

from cellcal.fake_devices.kinematics import Array

COUNTS_PER_TURN = 1 << 19


@dataclass(frozen=True)
class GearTrain:
    """Battery-backed motors behind the joints: ratio with the sign of the motor, and the wrist coupling."""

    ratios: tuple[float, ...]
    coupling: tuple[tuple[int, int, float], ...]  # (joint, motor, joint turns per motor turn)

    def radians_per_count(self) -> Array:
        """Return (n, n); single precision, because that is how the controller keeps it."""
        turns = np.diag(1.0 / np.array(self.ratios))
        for joint, motor, per_turn in self.coupling:
            turns[joint, motor] = per_turn
        return np.asarray(turns * 2.0 * pi / COUNTS_PER_TURN, dtype=np.float32).astype(float)


@dataclass(frozen=True)
class LinkMass:
    """A lump on a link: its place in the link's DH frame."""

    link: int  # 1-based
    kg: float
    at_m: tuple[float, float, float]


@dataclass(frozen=True)
class ArmModel:
    """The contents of the data sheet."""

    name: str
    dh: tuple[tuple[float, float, float, float], ...]  # theta, d, a, alpha
    coupling: tuple[tuple[int, int], ...]  # (axis, joint): the axis angle also contains that joint
    lower_deg: tuple[float, ...]
    upper_deg: tuple[float, ...]
    max_speed_deg_s: tuple[float, ...]
    masses: tuple[LinkMass, ...]
    stiffness_nm_rad: tuple[float, ...]
    park_deg: tuple[float, ...]
    parallel_axes: tuple[int, ...]  # rows whose next axis is parallel: a beta, not a d, is wrong there
    gears: GearTrain | None = None
    title: str = ""
    whole_coupling: tuple[tuple[float, ...], ...] = ()  # (n, n) in place of ``coupling``
    base: tuple[tuple[float, ...], ...] = ()  # (4, 4): what the rows do not hold before the first
    flange: tuple[tuple[float, ...], ...] = ()  # and after the last

    def dh_table(self) -> Array:
        """Return (n, 5) with beta = 0."""
        return np.column_stack([np.array(self.dh), np.zeros(len(self.dh))])

    def joint_coupling(self) -> Array:
        """Return (n, n): axis angles = coupling . joints."""
        if self.whole_coupling:
            return np.array(self.whole_coupling)
        matrix = np.eye(len(self.dh))
        for axis, joint in self.coupling:
            matrix[axis, joint] = 1.0
        return matrix


def _ur_model(name: str, d: tuple[float, ...], a: tuple[float, float], scale: float) -> ArmModel:
    alpha = (pi / 2, 0.0, 0.0, pi / 2, -pi / 2, 0.0)
    lengths = (0.0, a[0], a[1], 0.0, 0.0, 0.0)
    return ArmModel(
        name=name,
        dh=tuple((0.0, d[i], lengths[i], alpha[i]) for i in range(6)),
        coupling=(),
        lower_deg=(-360.0,) * 6,
        upper_deg=(360.0,) * 6,
        max_speed_deg_s=(120.0, 120.0, 180.0, 180.0, 180.0, 180.0),
        masses=(
            LinkMass(2, 12.0 * scale, (-a[0] / 2, 0.0, 0.13)),
            LinkMass(3, 4.0 * scale, (-a[1] / 2, 0.0, 0.05)),
            LinkMass(5, 3.0 * scale, (0.0, 0.0, 0.0)),
            LinkMass(6, 1.5 * scale, (0.0, 0.0, 0.0)),
        ),
        stiffness_nm_rad=(9e5, 7e5, 5e5, 3e5, 3e5, 3e5),
        park_deg=(-90.0, -90.0, -90.0, -90.0, 90.0, 0.0),
        parallel_axes=(1, 2),
    )


_M6IB = ArmModel(
    name="fanuc_m6ib",
    dh=(
        (0.0, 0.0, 0.150, -pi / 2),
        (-pi / 2, 0.0, 0.600, pi),
        (0.0, 0.0, 0.100, -pi / 2),
        (0.0, -0.615, 0.0, pi / 2),
        (0.0, 0.0, 0.0, -pi / 2),
        (0.0, -0.100, 0.0, pi),
    ),
    coupling=((2, 1),),
    lower_deg=(-170.0, -90.0, -170.0, -190.0, -140.0, -360.0),
    upper_deg=(170.0, 160.0, 285.0, 190.0, 140.0, 360.0),
    max_speed_deg_s=(150.0, 160.0, 170.0, 400.0, 400.0, 520.0),
    masses=(
        LinkMass(2, 14.0, (-0.30, 0.0, 0.0)),
        LinkMass(3, 16.0, (-0.02, 0.0, 0.0)),
        LinkMass(4, 9.0, (0.0, 0.30, 0.0)),
        LinkMass(6, 4.0, (0.0, 0.0, 0.0)),
    ),
    stiffness_nm_rad=(7e5, 7e5, 4.5e5, 1.5e5, 1.2e5, 1e5),
    park_deg=(-20.0, 10.0, -25.0, 15.0, -60.0, 20.0),
    parallel_axes=(1,),
    gears=GearTrain(
        ratios=(121.0, 153.0, -160.5, -80.25, -80.0, -50.0),
        coupling=((4, 3, -1.58e-4), (5, 3, -1.52e-4), (5, 4, -1.53e-4)),
    ),
)

MODELS: dict[str, ArmModel] = {
    model.name: model
    for model in (
        _M6IB,
        _ur_model("ur3", (0.1519, 0.0, 0.0, 0.11235, 0.08535, 0.0819), (-0.24365, -0.21325), 0.35),
        _ur_model("ur5", (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823), (-0.425, -0.39225), 0.65),
        _ur_model("ur3e", (0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921), (-0.24355, -0.2132), 0.35),
        _ur_model("ur5e", (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996), (-0.425, -0.3922), 0.65),
        _ur_model("ur10", (0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922), (-0.612, -0.5723), 1.0),
        _ur_model("ur10e", (0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655), (-0.6127, -0.57155), 1.0),
        _ur_model("ur16e", (0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655), (-0.4784, -0.36), 1.0),
        _ur_model("ur20", (0.2363, 0.0, 0.0, 0.201, 0.1593, 0.1543), (-0.862, -0.7287), 1.3),
        _ur_model("ur30", (0.2363, 0.0, 0.0, 0.201, 0.1593, 0.1543), (-0.637, -0.5037), 1.2),
    )
}
