"""One action of a robot at a time: a second one is refused while the first goes on."""

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import BusyError


def refuse_second_action(device: str, current: str, requested: str) -> None:
    """Raise BusyError where an action goes on; ``current`` is its name, empty without one."""
    if current:
        raise BusyError(
            device,
            make_message(
                "a {current_action} is under way, a {requested_action} was asked for.",
                current_action=current,
                requested_action=requested,
            ),
        )
