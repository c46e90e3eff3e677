"""What can be wrong with a program file: which file, where, what, and the cure."""

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message


class ProgramFileError(CellError):
    """A program file is not understood, or cannot take what it is given; the file stays untouched."""

    code = "program"

    def __init__(self, file: str, message: str, *, line: int = 0, column: int = 0, remedy: str = "") -> None:
        where = f"{file}:{line}:{column}" if line else file
        super().__init__(make_message("{where}: {message}", where=where, message=message), remedy=remedy)
        self.file = file
        self.line = line
        self.column = column
