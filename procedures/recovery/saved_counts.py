"""The first question of a recovery: whether the counts that it starts from are the newest that were saved.

Older counts lead to a zero that was right once. The measurements find most of that out later; a person who holds a
newer record or backup knows it now.
"""

from cellcal.calibration.mastering.counts import MasteringRecord
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Answer, Counts, Instruction
from cellcal.procedures.cell import Cell
from cellcal.procedures.instruction_page import PagedInstruction, with_page
from cellcal.procedures.recovery.recovery_pages import levers_page
from cellcal.procedures.run import DeclinedError

NEWEST = (
    "The recovery starts from the counts that were saved while the robot was healthy. Is no newer record or backup "
    "of this arm at hand?"
)


def saved_counts_page(record: MasteringRecord, last_counts: Counts | None) -> PagedInstruction:
    """Return the question with the saved counts, and what a tenth of a degree of each axis displaces the hook."""
    sentences = [
        NEWEST,
        make_message("Counts at zero: {counts_text}.", counts_text=_counts_text(record.counts_at_zero)),
    ]
    if last_counts is not None:
        sentences.append(
            make_message("Last healthy counts: {counts_text}.", counts_text=_counts_text(last_counts))
        )
    page = levers_page(Instruction("saved_counts", " ".join(sentences)), record)
    columns = {"counts at zero": record.counts_at_zero, "last healthy counts": last_counts}
    table = {name: counts for name, counts in columns.items() if counts is not None}
    return with_page(page, "ask", counts=table)


async def confirm_newest(cell: Cell, page: PagedInstruction) -> Answer:
    """Have a person confirm that no newer counts are at hand.

    Raises
    ------
    DeclinedError
        There are: this run would start from the wrong ones.
    """
    try:
        return await cell.operator.confirm(page)
    except RefusedError as error:
        raise DeclinedError(
            "newer counts than the saved ones are at hand",
            remedy=(
                "An engineer reads them in at the cell's computer: `cellcal mastering import`. "
                "Then start a new recovery."
            ),
        ) from error


def _counts_text(counts: Counts) -> str:
    return ", ".join(f"J{axis} {count}" for axis, count in enumerate(counts, 1))
