"""The root of everything this product raises on purpose, and the refusals of pure mathematics.

::

    CellError                      code, remedy
    ├─ CalibrationError            pure mathematics refuses; also a ValueError
    │   └─ DegenerateDataError     the data cannot determine the answer; .condition
    ├─ DeviceError …               drivers/errors.py
    ├─ ProcedureError …            procedures/run.py
    └─ ConfigError, StoreError     service/
"""

from cellcal.calibration.message import join_messages


class CellError(Exception):
    """An error with a stated cause and a remedy."""

    code = "cell"

    def __init__(self, message: str, *, remedy: str = "", code: str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        if code is not None:
            self.code = code

    def __str__(self) -> str:
        return join_messages(" ", filter(None, (self.message, self.remedy)))


class CalibrationError(CellError, ValueError):
    """The mathematics refuses its input or its result."""

    code = "calibration"


class DegenerateDataError(CalibrationError):
    """The data cannot determine the answer."""

    code = "calibration.degenerate"

    def __init__(self, message: str, *, remedy: str = "", condition: float = float("inf")) -> None:
        super().__init__(message, remedy=remedy)
        self.condition = condition
