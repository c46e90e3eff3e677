"""Makes of robots: tools and frames that every controller of one has, and how its people write a turn."""

from dataclasses import dataclass

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.arm.model_references import maker_of


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


# Brands of programs by the maker that the catalogue names; others have none that is read.
_BY_MAKER = {
    "FANUC": "fanuc",
    "KUKA": "kuka",
    "ABB": "abb",
    "Yaskawa Motoman": "yaskawa",
    "Universal Robots": "universal_robots",
}
_FANUC = "fanuc"
_ACROSS, _PARALLEL = 0.1, 0.9  # cosines between axes


def runs_programs_of(model: RobotModel, brand: str) -> bool:
    """Return whether a robot may run programs of a brand; one's own description may be of any make."""
    make, maker = make_of(model), maker_of(model.name)
    if make is not None:
        return make.brand == brand
    return not maker or _BY_MAKER.get(maker) == brand


def lacks_coupling(model: RobotModel, brand: str) -> bool:
    """Return whether joints of this brand's programs mean something else than those of the model.

    FANUC's J3 is counted against the horizon, the joint of a description against the link before.
    """
    return brand == _FANUC and _has_swung_forearm(model) and not model.joint_coupling[2, 1]


def _has_swung_forearm(model: RobotModel) -> bool:
    """Return whether joint 1 turns the arm, and joints 2 and 3 about parallel axes across it: no SCARA, no track."""
    if model.axis_count < 3 or (model.sliding is not None and model.sliding[:3].any()):
        return False
    first_second, second_third = model.placements[1, 2, 2], model.placements[2, 2, 2]
    return bool(abs(first_second) < _ACROSS and abs(second_third) > _PARALLEL)


def make_of(model: RobotModel) -> RobotMake | None:
    """Return the make of a model by its name; None for a description of one's own."""
    return next((make for make in MAKES if model.name.startswith(make.models)), None)


def flange_of(brand: str) -> str:
    """Return the name of the tool that is the flange, "" where a brand has none."""
    return _BY_BRAND[brand].flange if brand in _BY_BRAND else ""


def base_of(brand: str) -> str:
    """Return the name of the user frame that is the base, "" where a brand has none."""
    return _BY_BRAND[brand].base if brand in _BY_BRAND else ""
