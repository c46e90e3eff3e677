"""Errors of a network connection to a controller that cannot be made or is lost."""

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError, WireProtocolError


def no_connection_error(device: str, address: str, error: OSError, remedy: str) -> UnreachableError:
    """Return that a connection cannot be made."""
    return UnreachableError(
        device,
        make_message(
            "no connection to {address}: {strerror}.", address=address, strerror=error.strerror or error
        ),
        remedy=remedy,
    )


def lost_connection_error(device: str, error: Exception, remedy: str) -> UnreachableError:
    """Return that a connection was lost; without a reason of the system the controller ended it."""
    reason = getattr(error, "strerror", None) or "the controller hung up"
    return UnreachableError(
        device, make_message("the connection was lost: {reason}.", reason=reason), remedy=remedy
    )


def unreadable_answer_error(device: str, what: str, remedy: str, frame: str) -> WireProtocolError:
    """Return that an answer is not what the maker's document says; ``frame`` is how it came."""
    return WireProtocolError(
        device, make_message("an answer cannot be read: {what}.", what=what), remedy=remedy, frame=frame
    )
