"""The check that the robot which answers is the one of the cell file."""

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WrongDeviceError


def check_serial_number(device: str, found: str, expected: str) -> None:
    """Raise WrongDeviceError where a robot tells another serial number than the cell file.

    Raises
    ------
    RefusedError
        It tells none: whose robot it is cannot be checked, and nothing says that it is another one.
    """
    if not found.strip() and expected:
        raise RefusedError(
            device,
            make_message(
                "the robot tells no serial number, the cell file has {expected_serial!r}.",
                expected_serial=expected,
            ),
            remedy="Wait until the controller has started, then try again; see on the pendant whether it has one.",
        )
    if found != expected:
        raise WrongDeviceError(
            device,
            make_message(
                "the robot has the serial number {found_serial!r}, the cell file {expected_serial!r}.",
                found_serial=found,
                expected_serial=expected,
            ),
            remedy="Check the address, or correct the serial number in the cell file.",
        )


def describe_untold_serial(serial: str) -> str:
    """Return that a controller does not tell the serial number, so that the one that is shown proves nothing."""
    return make_message(
        "Its controller does not tell a serial number; {serial} is what the cell file says.", serial=serial
    )


def describe_second_robot(unit: str) -> str:
    """Return that a controller has more robots than the one that is read, which its name plate does not tell."""
    return make_message(
        "This controller has more than one robot; {unit} is read. Turn one axis of the robot that is meant, and see "
        "that its angle changes here.",
        unit=unit,
    )
