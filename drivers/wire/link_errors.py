"""Errors of a network connection to a controller that cannot be made or is lost."""

import os
import ssl

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import UnreachableError, WireProtocolError


def no_connection_error(device: str, address: str, error: OSError, remedy: str) -> UnreachableError:
    """Return that a connection cannot be made."""
    return UnreachableError(
        device,
        make_message("no connection to {address}: {strerror}.", address=address, strerror=find_reason(error)),
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


def find_reason(error: BaseException) -> str:
    """Return the system's words for why a connection failed, from behind the words of libraries around it."""
    waiting: list[BaseException | None] = [error]
    visited: set[int] = set()
    while waiting:
        each = waiting.pop(0)
        if each is None or id(each) in visited:
            continue
        visited.add(id(each))
        if isinstance(each, ssl.SSLError):  # its number is none of the system's
            what = (each.reason or "the handshake broke off").replace("_", " ").lower()
            return make_message("no TLS connection ({what})", what=what)
        if isinstance(each, OSError) and each.errno is not None:
            return os.strerror(each.errno) if each.errno > 0 else str(each.strerror)
        waiting += [*getattr(each, "exceptions", ()), each.__cause__, each.__context__]
    return str(error).rstrip(".") or type(error).__name__


def bracket_host(host: str) -> str:
    """Write a host as it stands in an address with a port: IPv6 in brackets."""
    return f"[{host}]" if ":" in host else host
