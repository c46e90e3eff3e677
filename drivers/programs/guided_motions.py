"""Motions that a sensor or another computer guides while the program runs: no file holds where they go."""

from cellcal.drivers.programs.shifts import ProgramShift, ShiftAxes

CHANGE_THE_SENDER = (
    "A sensor or another computer guides this motion: let it take up the change, too, or check the motion."
)
AXIS_BY_ITSELF = (
    "it moves an external axis by itself, and what that axis carries there, no point of the program says"
)


def guided_motion(line: int, instruction: str) -> ProgramShift:
    """Return a guided motion; which frame it is in, the program does not say."""
    return ProgramShift(
        line, instruction, ShiftAxes.USER_FRAME, point=instruction, quaternion=None, absent=CHANGE_THE_SENDER
    )
