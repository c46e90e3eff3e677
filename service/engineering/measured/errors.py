"""What refuses a file of measurements."""

from cellcal.calibration.errors import CellError


class MeasurementError(CellError):
    """A file of measurements cannot be understood; the remedy names the option that helps."""

    code = "measurements"
