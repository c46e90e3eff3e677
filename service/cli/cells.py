"""``cellcal check`` and ``cellcal fakes``: is the cell there, and a cell that is not."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.text import Text

if TYPE_CHECKING:
    from cellcal.service.runs.cell_check import CellCheckReport


def check(cell: Path, /, *, as_json: Annotated[bool, Parameter(name="--json")] = False) -> int:
    """Validate a cell file, reach every device it names, and compare what each says of itself.

    Parameters
    ----------
    cell
        The cell file (TOML).
    as_json
        Print one JSON object on standard output.
    """
    import asyncio

    from rich.markup import escape

    from cellcal.service.cli.printing import STDERR_CONSOLE, PlainTable, print_json, say_while_waiting
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.exit_codes import ExitCode
    from cellcal.service.runs.cell_check import check_cell

    with say_while_waiting("asking the devices of the cell"):
        report = asyncio.run(check_cell(read_cell_file(cell)))
    if as_json:
        print_json(report.as_object())
    else:
        title = escape(f"cell {report.cell}")
        table = PlainTable("device", "state", "what it says", "what to do", title=title)
        for device in report.devices:
            colour = "green" if device.is_ready else "red"
            state = Text(device.state, style=colour)
            table.add_row(device.name, state, device.message, device.remedy)
        STDERR_CONSOLE.print(table)
        _print_joints(report)
        _print_evidence(report)
        for line in report.advice:
            STDERR_CONSOLE.print(f"[bold yellow]{escape(line)}[/]")
        if report.damage:
            STDERR_CONSOLE.print(f"[bold red]{escape(report.damage)}[/]")
    if not report.all_reached:
        return ExitCode.UNREACHABLE
    if report.damage:
        return ExitCode.SIGNATURE
    return ExitCode.BUSY if report.in_use else ExitCode.PASS


def _print_joints(report: "CellCheckReport") -> None:
    """Print where the axes of each robot stand: a wrong sign, zero or order is found at the pendant only."""
    from cellcal.service.cli.printing import STDERR_CONSOLE

    for device in report.devices:
        if device.joints:
            axes = ", ".join(f"{joint.name} {joint.value:.3f} {joint.unit}" for joint in device.joints)
            line = f"{device.name} shows {axes}. Compare with the pendant, at two postures that differ in all axes."
            STDERR_CONSOLE.print(line, markup=False)


def _print_evidence(report: "CellCheckReport") -> None:
    """Print what stands behind each ability of each robot; what no robot has confirmed is named first."""
    from cellcal.drivers.wire.evidence import NOT_CONFIRMED
    from cellcal.service.cli.printing import STDERR_CONSOLE, PlainTable

    for device in report.devices:
        if not device.evidence:
            continue
        confirmed = [row for row in device.evidence if row.robot != NOT_CONFIRMED]
        line = (
            f"{device.name}: {len(confirmed)} of {len(device.evidence)} abilities are confirmed on a robot."
        )
        STDERR_CONSOLE.print(line, style="bold yellow", markup=False)
        columns = ("ability", "read in the maker's document", "confirmed by an independent client")
        table = PlainTable(*columns, "confirmed on a robot", title=f"what stands behind {device.name}")
        for row in device.evidence:
            table.add_row(row.ability, row.document, row.client, row.robot)
        STDERR_CONSOLE.print(table)


def fakes(cell: Path, /) -> int:
    """Play the devices that a cell file names, on its (loopback) addresses, until interrupted.

    Parameters
    ----------
    cell
        The cell file (TOML); its [fake] table gives seed, time factor and control port.
    """
    import asyncio

    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.demo.fake_cell import running_fakes

    read_cell_file(cell)  # a fault in the file is said in our words, before anything starts

    async def run_fakes() -> None:
        async with running_fakes(cell) as fake_cell:
            STDERR_CONSOLE.print("The fake devices are up. Ctrl+C ends them.")
            print_json({"ready": True, "control": [fake_cell.host, fake_cell.port]})
            await asyncio.Event().wait()

    try:
        asyncio.run(run_fakes())
    except KeyboardInterrupt:
        STDERR_CONSOLE.print("The fake devices have ended.")
    return 0
