"""What a device can do to us, one class per scenario.

::

    CellError                      calibration/errors.py
    └─ DeviceError                 .device
        ├─ UnreachableError        no connection, or lost                        retry after the cable
        ├─ DeviceTimeoutError      also a builtin TimeoutError                   retry once
        ├─ WireProtocolError       bytes the document does not allow; .frame     report, do not retry
        ├─ RefusedError            the device said no; .vendor_code, .vendor_text
        ├─ MotionStoppedError      emergency stop, protective stop, mode switch  operator
        ├─ BusyError               two commands at once                          our bug
        ├─ NoOperatorError         a question without an operator               resume at a terminal or page
        └─ WrongDeviceError        serial or model is not the one in cell.toml   operator
"""

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import limit_to_line, make_message

__all__ = [
    "LOOK_FIRST",
    "BusyError",
    "CellError",
    "DeviceError",
    "DeviceTimeoutError",
    "MotionStoppedError",
    "NoOperatorError",
    "RefusedError",
    "UnreachableError",
    "WireProtocolError",
    "WrongDeviceError",
]


LOOK_FIRST = "Look at the robot first: it should have stopped. Use the emergency stop if it has not."
_MOST_OF_ANSWER = 1000  # characters of what a device sent, in a text for a person


class DeviceError(CellError):
    """A device did not do what was asked; ``device`` is its name in cell.toml."""

    code = "device"

    def __init__(self, device: str, message: str, *, remedy: str = "") -> None:
        is_named = message.startswith(f"{device}: ")  # the text of an error of the same device
        text = message if is_named else make_message("{device}: {message}", device=device, message=message)
        super().__init__(limit_to_line(text, _MOST_OF_ANSWER), remedy=limit_to_line(remedy, _MOST_OF_ANSWER))
        self.device = device


class UnreachableError(DeviceError):
    """No connection, or the connection was lost."""

    code = "device.unreachable"


class DeviceTimeoutError(DeviceError, TimeoutError):
    """The device did not answer within its deadline."""

    code = "device.timeout"


class WireProtocolError(DeviceError):
    """The device sent something its document does not allow."""

    code = "device.protocol"

    def __init__(self, device: str, message: str, *, remedy: str = "", frame: str = "") -> None:
        super().__init__(device, message, remedy=remedy)
        self.frame = frame


class RefusedError(DeviceError):
    """The device understood and said no."""

    code = "device.refused"

    def __init__(
        self, device: str, message: str, *, remedy: str = "", vendor_code: int = 0, vendor_text: str = ""
    ) -> None:
        super().__init__(device, message, remedy=remedy)
        self.vendor_code = vendor_code
        self.vendor_text = vendor_text


class MotionStoppedError(DeviceError):
    """The robot was stopped by its safety system, its operator or its mode switch."""

    code = "device.stopped"


class BusyError(DeviceError):
    """A second command while one is under way: a bug of ours."""

    code = "device.busy"


class WrongDeviceError(DeviceError):
    """The serial number or model is not the one in cell.toml."""

    code = "device.wrong"


class NoOperatorError(DeviceError):
    """A question without an operator to answer it: it was not declined."""

    code = "device.nobody"
