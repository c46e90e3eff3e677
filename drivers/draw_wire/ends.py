"""A wire that is all in or all out measures nothing, whatever bus it is on."""

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError


def refuse_near_ends(device: str, value_m: float, range_m: float, margin_m: float) -> None:
    """Raise RefusedError for a length within ``margin_m`` of either end of the range."""
    if value_m <= margin_m:
        raise RefusedError(
            device,
            make_message(
                "the wire is all in ({value_mm:.1f} mm): it is not hooked, or it has snapped.",
                value_mm=value_m * 1000.0,
            ),
            remedy="Stop the robot, look at the wire without reaching into the cell, and hook it again.",
        )
    if value_m >= range_m - margin_m:
        raise RefusedError(
            device,
            make_message("the wire is out to its end ({value_mm:.1f} mm).", value_mm=value_m * 1000.0),
            remedy="Move the arm towards the gauge and choose poses within its range.",
        )


def moved_zero_error(device: str, moved_m: float) -> RefusedError:
    """Return the error for a zero that is not where it was when the gauge was connected."""
    return RefusedError(
        device,
        make_message(
            "the zero of the gauge moved by {moved_mm:.1f} mm since it was connected.",
            moved_mm=moved_m * 1000.0,
        ),
        remedy="Its readings cannot be combined: restore the preset, or begin from the reference.",
    )
