"""A run that stood still for long: what became of the cell meanwhile no witness tells, so a person is asked."""

from datetime import UTC, datetime

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Instruction, Operator
from cellcal.procedures.run import DeclinedError
from cellcal.service.record.journal import Journal
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.times import read_time

MOST_H = 8.0  # a shift
_QUESTION = (
    "This run stood still for {:.1f} hours. The robot has warmed up or cooled down, and tool, "
    "pointer, wire or workpiece may have been touched. Go on only if nothing was; otherwise start a new run. Go on?"
)
_CLOCK = (
    "The clock of this computer stands {:.1f} hours before the last entry of this run: how long it stood still "
    "cannot be told. Set the clock. Go on only if nothing in the cell was touched since. Go on?"
)


async def agree_if_old(
    operator: Operator, journal: Journal, run_id: str, *, now_utc: datetime | None = None
) -> None:
    """Have a person agree that a run continues which stood still for more than a shift, or for an unknown time.

    Raises
    ------
    DeclinedError
        The person said no; the run stays as it is.
    """
    if RunStore(journal).find_run(run_id).state == RunVerdict.PASSED:
        return
    last = read_time(journal.list_events(run_id)[-1].wall_utc)
    age_h = ((now_utc or datetime.now(UTC)) - last).total_seconds() / 3600.0
    if 0.0 <= age_h <= MOST_H:
        return
    question = make_message(_QUESTION if age_h > 0.0 else _CLOCK, abs(age_h))
    try:
        await operator.confirm(Instruction("run_is_old", question))
    except RefusedError as error:
        raise DeclinedError(
            "the answer was no: the run was not continued.",
            remedy="Start a new run; the stored points stay readable.",
        ) from error
