"""The model of the catalogue that a maker's name of a robot means."""

from cellcal.calibration.arm.robot_models.catalogue_index import find_robots

_MAKER = "fanuc"


def name_model(robot: str) -> str:
    """Return the name of a model for a maker's name such as R-2000iC/165F; "" where none has exactly that name."""
    if not robot.strip():
        return ""
    found = [entry for entry in find_robots(robot, _MAKER) if entry.usable]
    exact = [entry for entry in found if _plain(entry.name) == _plain(f"{_MAKER}{robot}")]
    return exact[0].name if len(exact) == 1 else ""


def _plain(text: str) -> str:
    return "".join(letter for letter in text.lower() if letter.isalnum())
