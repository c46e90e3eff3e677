"""What the safety states of a controller mean for a technician."""

from collections.abc import Sequence
from dataclasses import dataclass

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import WireProtocolError
from cellcal.drivers.interfaces import Condition, Readiness

# OperationalModeEnumeration of Opc.Ua.Robotics.NodeSet2.xml
_MODES = {
    0: "OTHER",
    1: "MANUAL_REDUCED_SPEED",
    2: "MANUAL_HIGH_SPEED",
    3: "AUTOMATIC",
    4: "AUTOMATIC_EXTERNAL",
}


@dataclass(frozen=True, slots=True)
class SafetyState:
    """One safety state, read."""

    mode: int
    emergency_stop: bool
    protective_stop: bool


def condition_of(states: Sequence[SafetyState]) -> Condition:
    """Say whether the robot can be used, and who must act. Without any state nothing can be said."""
    if not states:
        return Condition(
            Readiness.NOT_READY,
            "the OPC UA server does not show its emergency stop, protective stop and operational mode.",
            "Ask the maker of the controller for a server that follows OPC 40010-1 in full.",
        )
    if any(state.emergency_stop for state in states):
        return Condition(
            Readiness.STOPPED,
            "the emergency stop is active.",
            "Look at the cell, then release the emergency stop.",
        )
    if any(state.protective_stop for state in states):
        return Condition(
            Readiness.STOPPED,
            "a protective stop is active.",
            "Look at the cell, then clear the stop at the pendant.",
        )
    return Condition(Readiness.READY)


def mode_name(device: str, states: Sequence[SafetyState]) -> str:
    """Return the operational mode in the words of OPC 40010-1; those of several states in their order."""
    names = []
    for state in states:
        name = _MODES.get(state.mode)
        if name is None:
            raise WireProtocolError(
                device,
                make_message(
                    "the OPC UA server shows the operational mode {mode}, which is none.", mode=state.mode
                ),
                remedy="Report this with the name and the version of the server.",
            )
        if name not in names:
            names.append(name)
    return ", ".join(names)
