"""What an FTP server's refusals mean: of one file for now, of one file for good, of the login, or a lost link."""

import ftplib

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError

_AGAIN = "Read it once more; if it happens again, look at the network."
_IN_USE = "Wait until the controller has done with it (a backup, an open editor), then read once more."
_FEW_CLIENTS = "It serves few clients at once: close others, such as a backup program, then read once more."
_PASSIVE = "Let passive FTP through the firewall between: the controller names a port for each file."
_RIGHTS = "Allow reading on the controller (SETUP > Host Comm > FTP), or give --user and --password-file."
_PROTECTED = "Look at the pendant whether it is protected, or open in the editor."
NOT_THERE, WRONG_LOGIN = "550", "530"
_ENDED, _NO_DATA = "421", "425"


class FileNotGivenError(RefusedError):
    """The controller refuses one file for now; others may be read."""


def name_refusal(device: str, doing: str, error: ftplib.Error, *, writes: bool = False) -> DeviceError:
    """Return what a refusal means, with what to do."""
    code, reason = str(error)[:3], plain_reason(error)
    if not isinstance(error, ftplib.error_temp | ftplib.error_perm):
        return lost_link_error(device, doing, error)
    if code == _ENDED:
        text = make_message(
            "the controller ended the FTP connection while {doing}: {reason}.", doing=doing, reason=reason
        )
        return UnreachableError(device, text, remedy=_FEW_CLIENTS)
    if code == _NO_DATA:
        text = make_message(
            "the controller opened no data connection while {doing}: {reason}.", doing=doing, reason=reason
        )
        return UnreachableError(device, text, remedy=_PASSIVE)
    if isinstance(error, ftplib.error_temp):
        text = make_message(
            "the controller refuses for now while {doing}: {reason}.", doing=doing, reason=reason
        )
        return FileNotGivenError(device, text, remedy=_IN_USE, vendor_code=int(code), vendor_text=reason)
    text = make_message(
        "the FTP {code} was refused while {doing}: {reason}.",
        code="login" if code == WRONG_LOGIN else "command",
        doing=doing,
        reason=reason,
    )
    return RefusedError(device, text, remedy=_PROTECTED if writes and code != WRONG_LOGIN else _RIGHTS)


def lost_link_error(device: str, doing: str, error: BaseException) -> UnreachableError:
    """Return the error of a connection that broke."""
    text = make_message(
        "the FTP connection was lost while {doing}: {reason}.", doing=doing, reason=plain_reason(error)
    )
    return UnreachableError(device, text, remedy=_AGAIN)


def plain_reason(error: BaseException) -> str:
    """Return what an error says in one line, without a full stop."""
    reason = getattr(error, "strerror", None) or str(error) or "it hung up"
    return " ".join(reason.split()).rstrip(".")[:200]
