"""``cellcal alignments``: fixtures seen from robots, on the screen and as a text file."""

import math
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

alignments = App(name="alignments", help="Show and export where fixtures stand in the robots' bases.")

CellFile = Annotated[Path, Parameter(name="--cell", help="The cell file (TOML).")]


@alignments.command
def show(*, cell: CellFile) -> int:
    """Print every alignment of the cell's journal, oldest first."""
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.record.journal_files import open_journal
    from cellcal.service.record.run_store import RunStore

    with open_journal(read_cell_file(cell)) as journal:
        for one in RunStore(journal).list_alignments():
            x, y, z = (value * 1e3 for value in one.base_fixture.position_m)
            STDERR_CONSOLE.print(
                f"{one.fixture} from {one.robot_serial}: x {x:.3f}, y {y:.3f}, z {z:.3f} mm, within "
                f"{one.origin_u_m * 1e3:.3f} mm and {math.degrees(one.angle_u_rad):.4f} deg (k=2)",
                markup=False,
                soft_wrap=True,
            )
    return 0


@alignments.command
def export(*, cell: CellFile, out: Path) -> int:
    """Write every alignment of the cell's journal as a text file.

    Parameters
    ----------
    out
        The file to write (.aln).
    """
    from cellcal.calibration.points.alignment import alignment_text
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.files import SHARED_FILE, replace_file
    from cellcal.service.record.journal_files import open_journal
    from cellcal.service.record.run_store import RunStore

    with open_journal(read_cell_file(cell)) as journal:
        stored = RunStore(journal).list_alignments()
    replace_file(out, alignment_text(stored), mode=SHARED_FILE)
    STDERR_CONSOLE.print(f"{len(stored)} alignments: {out}", markup=False, soft_wrap=True)
    return 0
