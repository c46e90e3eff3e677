"""Names in brackets or between colons are printed as they are, and no command prints a text past that."""

import ast
import io
from pathlib import Path

from rich.console import Console

from cellcal.service.cli.printing import PlainTable

CLI = Path(__file__).parents[2] / "service" / "cli"
OWN_CELLS = {"monitor.py", "program_screen.py"}  # make every cell a Text, or escape it


def test_a_table_shows_names_letter_by_letter() -> None:
    table = PlainTable("[red]head", title="[bold]JOB:PICK:")
    table.add_row("[link=x]J[/link] :robot: \\[y]")
    out = io.StringIO()
    Console(file=out, width=80, emoji=False).print(table)
    for text in ("[red]head", "[bold]JOB:PICK:", "[link=x]J[/link] :robot: \\[y]"):
        assert text in out.getvalue()


def test_no_console_takes_emoji_and_no_command_another_table() -> None:
    for path in sorted(CLI.glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Console":
                assert "emoji" in {word.arg for word in node.keywords}, path.name
            if isinstance(node, ast.ImportFrom) and node.module == "rich.table":
                names = {name.name for name in node.names}
                assert "Table" not in names or path.name in OWN_CELLS | {"printing.py"}, path.name
