"""What of a robot can be watched at all, in words: the same where it is followed and where a cell is listed."""

from cellcal.drivers.interfaces import RobotCapabilities

_ENCODERS = "its alarms, encoder counts and mastering: a lost position is seen"
_COUNTS = (
    "its alarms and encoder counts: a lost position is seen. Its mastering is set at the pendant only, and a changed "
    "one is NOT seen: run a drift check after service"
)
_STOPS_ONLY = (
    "its stops and faults only. It tells no encoder counts and no mastering here, so a lost position is NOT seen: "
    "run a drift check after a collision, and after a joint was exchanged"
)


def describe_coverage(capabilities: RobotCapabilities) -> str:
    """Say what `cellcal watch` sees of a robot with these capabilities, and what it does not."""
    if capabilities.writes_mastering:
        return _ENCODERS
    return _COUNTS if capabilities.reads_encoder_counts else _STOPS_ONLY
