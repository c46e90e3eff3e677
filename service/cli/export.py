"""``cellcal export runs | history | points | parameters``: tables for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

if TYPE_CHECKING:
    from cellcal.service.export.tables import ExportTable

export = App(
    name="export", help="Tables for spreadsheets and other programs: CSV or XLSX, SI units, every digit kept."
)
Out = Annotated[Path | None, Parameter(name=["--out", "-o"])]


@export.command
def runs(cell: Path, /, *, out: Out = None, delimiter: str = ",") -> int:
    """Export all runs of a cell.

    Parameters
    ----------
    cell
        The cell file (TOML).
    out
        A .csv or .xlsx file; CSV on standard output when not said.
    delimiter
        Of a CSV file: a comma, a semicolon, or a tab.
    """
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.cell_tables import runs_table

    return _write_table(runs_table(read_cell_file(cell)), out, delimiter)


@export.command
def history(cell: Path, /, *, out: Out = None, delimiter: str = ",") -> int:
    """Export every figure that a run ended with: value, uncertainty, limit, decision.

    Parameters
    ----------
    cell
        The cell file (TOML).
    out
        A .csv or .xlsx file; CSV on standard output when not said.
    delimiter
        Of a CSV file: a comma, a semicolon, or a tab.
    """
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.cell_tables import history_table

    return _write_table(history_table(read_cell_file(cell)), out, delimiter)


@export.command
def points(cell: Path, run_id: str = "last", /, *, out: Out = None, delimiter: str = ",") -> int:
    """Export every reading of one run, those too that were not used, with the reason.

    Parameters
    ----------
    cell
        The cell file (TOML).
    run_id
        The run; the newest when not said.
    out
        A .csv or .xlsx file; CSV on standard output when not said.
    delimiter
        Of a CSV file: a comma, a semicolon, or a tab.
    """
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.cell_tables import points_table

    return _write_table(points_table(read_cell_file(cell), run_id), out, delimiter)


@export.command
def parameters(
    cell: Path,
    robot_serial: str,
    /,
    *,
    number: int | None = None,
    out: Out = None,
    delimiter: str = ",",
) -> int:
    """Export a robot's parameter sets, all versions or one.

    Parameters
    ----------
    cell
        The cell file (TOML); the sets are beside it.
    robot_serial
        The robot.
    number
        One version only.
    out
        A .csv or .xlsx file; CSV on standard output when not said.
    delimiter
        Of a CSV file: a comma, a semicolon, or a tab.
    """
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.cell_tables import parameters_table

    return _write_table(parameters_table(read_cell_file(cell), robot_serial, number), out, delimiter)


@export.command
def mcap(
    cell: Path, run_id: str = "last", /, *, out: Annotated[Path, Parameter(name=["--out", "-o"])]
) -> int:
    """Export one run as an MCAP file, for Foxglove or Lichtblick; needs the extra cellcal[mcap].

    Parameters
    ----------
    cell
        The cell file (TOML).
    run_id
        The run; the newest when not said.
    out
        The file to write.
    """
    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.export.mcap_file import write_mcap

    count = write_mcap(read_cell_file(cell), run_id, out)
    STDERR_CONSOLE.print(f"{out}: {count} messages.", markup=False, soft_wrap=True)
    return 0


def _write_table(table: "ExportTable", out: Path | None, delimiter: str) -> int:
    import sys

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.export.table_files import as_csv, as_csv_file, as_xlsx_file
    from cellcal.service.export.tables import ExportError
    from cellcal.service.files import SHARED_FILE, replace_file

    if out is None:
        sys.stdout.write(as_csv(table, delimiter).replace("\r\n", "\n"))
        return 0
    if out.suffix.lower() not in (".csv", ".xlsx"):
        raise ExportError(f"{out} is neither .csv nor .xlsx.", remedy="End its name in one of these.")
    xlsx = out.suffix.lower() == ".xlsx"
    replace_file(out, as_xlsx_file([table]) if xlsx else as_csv_file(table, delimiter), mode=SHARED_FILE)
    STDERR_CONSOLE.print(f"{out}: {len(table.rows)} rows of {table.title}.", markup=False, soft_wrap=True)
    return 0
