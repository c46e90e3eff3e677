"""What of a robot can be watched at all, in words: the same where it is followed and where a cell is listed."""

from cellcal.drivers.interfaces import RobotCapabilities

_ENCODERS = "its alarms, encoder counts and mastering: a lost position is seen"
_COUNTS = (
    "its alarms and encoder counts: a lost position is seen. Its mastering is set at the pendant only: run a drift "
    "check after service"
)
_ZERO = ", and the data of its zero that its controller shows: another zero is seen"
_LOG = ", and its log: a position that was lost and brought back in between is seen"
_OWN_WORDS = (
    "its alarms and the state of its axes: a lost position is seen when the controller says so. It tells no encoder "
    "counts here: run a drift check after service"
)
_STOPS_ONLY = (
    "its stops and faults only. It tells no encoder counts and no mastering here, so a lost position is NOT seen: "
    "run a drift check after a collision, and after a joint was exchanged"
)


def describe_coverage(capabilities: RobotCapabilities) -> str:
    """Say what `cellcal watch` sees of a robot with these capabilities, and what it does not."""
    if capabilities.writes_mastering:
        return _ENCODERS
    if not sees_losses(capabilities):
        return _STOPS_ONLY
    own = _COUNTS if capabilities.reads_encoder_counts else _OWN_WORDS
    return own + _ZERO * capabilities.shows_position_data + _LOG * capabilities.keeps_position_history


def sees_losses(capabilities: RobotCapabilities) -> bool:
    """Whether anything of a robot with these capabilities shows a lost position."""
    return capabilities.reads_encoder_counts or capabilities.tells_lost_position
