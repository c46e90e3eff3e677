"""What of a robot can be watched at all, in words: the same where it is followed and where a cell is listed."""

from cellcal.drivers.interfaces import RobotCapabilities

_ENCODERS = "its alarms, encoder counts and mastering: a lost position is seen"
_STOPS_ONLY = (
    "its stops and faults only. It tells no encoder counts and no mastering here, so a lost position is NOT seen: "
    "run a drift check after a collision, and after a joint was exchanged"
)


def describe_coverage(capabilities: RobotCapabilities) -> str:
    """Say what `cellcal watch` sees of a robot with these capabilities, and what it does not."""
    return _ENCODERS if capabilities.writes_mastering else _STOPS_ONLY
