"""The arm's own kinematics, measured by the maker at the factory, and the drawing that they belong to.

Source: the maker's description of the primary client interface: sub-package 5 holds checksums, theta, a, d, alpha;
sub-package 6 the limits, speeds and nominal DH of the arm, and the code of its type.
The numbers of sub-package 5 are absolute, not differences to the nominal arm. d of the parallel joints may be
hundreds of metres that cancel: see cellcal.calibration.arm.ur_factory before using them as they are.
"""

import math
import struct
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.arm.kinematics import DhTable
from cellcal.calibration.arm.ur_factory import calibration_hash
from cellcal.calibration.message import make_message
from cellcal.drivers.universal_robots.primary_interface import read_sub_packages, unreadable_error
from cellcal.drivers.universal_robots.state import Six

_KINEMATICS = struct.Struct(">6I6d6d6d6dI")
_CONFIGURATION = struct.Struct(">12d12d5d6d6d6d6d4i")  # newer software may add to it
_KINEMATICS_INFO, _CONFIGURATION_DATA = 5, 6
_LINEARISED = 2


@dataclass(frozen=True, slots=True)
class FactoryKinematics:
    """DH parameters as the controller uses them: Rz(theta + q) Tz(d) Tx(a) Rx(alpha), joint by joint."""

    theta_rad: Six
    a_m: Six
    d_m: Six
    alpha_rad: Six
    checksums: tuple[int, int, int, int, int, int]
    status: int  # 0 not initialised, 1 not linearised, 2 linearised

    @property
    def is_measured(self) -> bool:
        """Whether the controller says that the maker measured this arm; else arms of a type may share the table."""
        return self.status == _LINEARISED

    def to_table(self) -> DhTable:
        """Return the table for cellcal.calibration.arm.ur_factory.factory_model."""
        return DhTable.from_rows(np.array([self.theta_rad, self.d_m, self.a_m, self.alpha_rad]).T)

    @property
    def name(self) -> str:
        """Name of the table, ``calib_`` and a number, by which the maker's ROS driver knows it as well."""
        return calibration_hash(self.to_table())


@dataclass(frozen=True, slots=True)
class ControllerArm:
    """The arm as its controller describes it."""

    type_code: int
    nominal: DhTable  # the drawing
    lower_rad: Six
    upper_rad: Six
    max_speed_rad_s: Six
    factory: FactoryKinematics


async def read_controller_arm(device: str, address: str, *, deadline_s: float) -> ControllerArm:
    """Read type, drawing, limits and factory calibration; change nothing. Errors as of ``read_sub_packages``."""
    found = await read_sub_packages(
        device, address, (_KINEMATICS_INFO, _CONFIGURATION_DATA), deadline_s=deadline_s
    )
    kinematics = decode_kinematics(device, found[_KINEMATICS_INFO])
    return decode_arm(device, found[_CONFIGURATION_DATA], kinematics)


async def read_factory_kinematics(device: str, address: str, *, deadline_s: float) -> FactoryKinematics:
    """Read the first kinematics that are sent; change nothing. Errors as of ``read_sub_packages``."""
    found = await read_sub_packages(device, address, (_KINEMATICS_INFO,), deadline_s=deadline_s)
    return decode_kinematics(device, found[_KINEMATICS_INFO])


def decode_kinematics(device: str, data: bytes) -> FactoryKinematics:
    """Read the kinematics sub-package."""
    if len(data) != _KINEMATICS.size:
        raise unreadable_error(
            device, make_message("kinematics of {data_count} bytes", data_count=len(data)), data
        )
    values = _KINEMATICS.unpack(data)
    if not all(map(math.isfinite, values[6:30])):
        raise unreadable_error(device, "kinematics that are not numbers", data)
    return FactoryKinematics(
        theta_rad=values[6:12],
        a_m=values[12:18],
        d_m=values[18:24],
        alpha_rad=values[24:30],
        checksums=values[:6],
        status=values[30],
    )


def decode_arm(device: str, data: bytes, factory: FactoryKinematics) -> ControllerArm:
    """Read the configuration sub-package."""
    if len(data) < _CONFIGURATION.size:
        raise unreadable_error(
            device, make_message("a configuration of {data_count} bytes", data_count=len(data)), data
        )
    values = _CONFIGURATION.unpack_from(data)
    if not all(map(math.isfinite, values[:53])):
        raise unreadable_error(device, "a configuration that is not numbers", data)
    a, d, alpha, theta = (values[start : start + 6] for start in (29, 35, 41, 47))
    return ControllerArm(
        type_code=values[55],
        nominal=DhTable.from_rows(np.array([theta, d, a, alpha]).T),
        lower_rad=values[0:12:2],
        upper_rad=values[1:12:2],
        max_speed_rad_s=values[12:24:2],
        factory=factory,
    )
