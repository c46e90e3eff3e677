"""Makes of robots: tools and frames that every controller of one has, and how its people write a turn."""

from dataclasses import dataclass

from cellcal.calibration.arm.kinematics import RobotModel


@dataclass(frozen=True)
class RobotMake:
    """One make, by its brand's package in `drivers`."""

    brand: str
    models: str  # what the names of its models begin with
    orientation: str  # a convention of `calibration.orientation`
    flange: str = ""  # the tool that is not entered, for it is the flange; "" where there is none
    base: str = ""  # the user frame that is not entered, for it is the base


MAKES = (
    RobotMake("fanuc", "fanuc_", "fanuc_wpr", "0", "0"),
    RobotMake("kuka", "kuka_", "kuka_abc", "0", "0"),
    RobotMake("abb", "abb_", "abb_quaternion", "tool0", "wobj0"),
    RobotMake("yaskawa", "yaskawa_", "yaskawa_rpy"),
    RobotMake("universal_robots", "ur", "ur_rotation_vector", base="base"),
)
_BY_BRAND = {make.brand: make for make in MAKES}


def make_of(model: RobotModel) -> RobotMake | None:
    """Return the make of a model by its name; None for a description of one's own."""
    return next((make for make in MAKES if model.name.startswith(make.models)), None)


def flange_of(brand: str) -> str:
    """Return the name of the tool that is the flange, "" where a brand has none."""
    return _BY_BRAND[brand].flange if brand in _BY_BRAND else ""


def base_of(brand: str) -> str:
    """Return the name of the user frame that is the base, "" where a brand has none."""
    return _BY_BRAND[brand].base if brand in _BY_BRAND else ""
