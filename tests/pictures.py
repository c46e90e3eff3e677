"""``python -m tests.pictures [demo] [identify]``: draw the README's pictures from real runs, all if none is named."""

import asyncio
import io
import logging
import re
import shutil
import sys
import tempfile
from pathlib import Path

from rich.console import Console

from cellcal.service.cli.demo_output import DemoPrinter
from cellcal.service.demo.recovery_demo import DemoScenario, run_recovery_demo
from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.plots.identify_plots import draw_identification

PICTURES = Path(__file__).parents[1] / "deploy" / "pictures"
MEASURED = Path(__file__).parent / "data" / "ipa_ur10" / "series_b_joint_configurations.csv"


def main() -> None:
    """Draw those that are named."""
    drawings = {"demo": draw_demo, "identify": draw_identify}
    for name in sys.argv[1:] or drawings:
        drawings[name]()


def draw_identify() -> None:
    """Identify the arm that ships with the tests, and keep the overview page."""
    with tempfile.TemporaryDirectory() as folder:
        draw_identification(identify_file(MEASURED, "ur10"), Path(folder))
        shutil.copy(Path(folder) / "overview.png", PICTURES / "identify.png")


def draw_demo() -> None:
    """Tell the story into a recording console and keep it as SVG, without fonts from another host."""
    logging.disable(logging.WARNING)
    console = Console(record=True, width=112, force_terminal=True, file=io.StringIO(), highlight=False)
    console.print("[bold green]$[/] make demo")
    with tempfile.TemporaryDirectory() as folder, DemoPrinter(console) as printer:
        # no bar in a still picture
        report = asyncio.run(run_recovery_demo(Path(folder), DemoScenario(say=printer.print_line)))
    printer.close_with(report, console)
    svg = console.export_svg(title="cellcal demo --headless")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    svg = svg.replace("Fira Code", "DejaVu Sans Mono")
    (PICTURES / "demo.svg").write_text(
        "\n".join(line.rstrip() for line in svg.splitlines()) + "\n", encoding="utf-8"
    )


if __name__ == "__main__":
    main()
