"""``python -m tests.pictures``: draw the README's picture of the demo from a real run of it."""

import asyncio
import io
import logging
import re
import tempfile
from pathlib import Path

from rich.console import Console

from service.cli.story import Teller
from service.demo.story import Plot, tell_story

PICTURE = Path(__file__).parents[1] / "deploy" / "pictures" / "demo.svg"


def main() -> None:
    """Tell the story into a recording console and keep it as SVG, without fonts from another host."""
    logging.disable(logging.WARNING)
    console = Console(record=True, width=112, force_terminal=True, file=io.StringIO(), highlight=False)
    console.print("[bold green]$[/] make demo")
    with tempfile.TemporaryDirectory() as folder, Teller(console) as teller:
        # no bar in a still picture
        report = asyncio.run(tell_story(Path(folder), Plot(say=teller.say)))
    teller.close_with(report, console)
    svg = console.export_svg(title="cellcal demo --headless")
    svg = re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)
    svg = svg.replace("Fira Code", "DejaVu Sans Mono")
    PICTURE.write_text("\n".join(line.rstrip() for line in svg.splitlines()) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
