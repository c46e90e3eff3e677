"""``cellcal bench``: speed and accuracy against peers, on the same data, in one run."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from rich.markup import escape
from rich.text import Text

if TYPE_CHECKING:
    from rich.console import Console

    from cellcal.service.engineering.bench.reference import ReferenceComparison
    from cellcal.service.engineering.bench.results import BenchTopic

_FILE_WIDTH = 170


def bench(  # noqa: PLR0913  # a command's options are its arguments
    *,
    only: str = "",
    reference: bool = False,
    data: Path | None = None,
    robot: str = "",
    out: Path | None = None,
    peer_python: tuple[str, ...] = (),
    seed: int = 0,
    rounds: int = 2,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Measure speed and accuracy against pybotics, figaroh, roboticstoolbox and a pinocchio loop.

    Peers that are not installed are named, and left out. Ratios of one run on one machine mean something;
    a time alone does not.

    Parameters
    ----------
    only
        Topics, separated by commas: identify, compensate, poses, real. All if not given.
    reference
        Instead, solve the shipped reference problems, whose answers come from an independent solver, and print
        every difference beside its tolerance. Ends with exit code 3 if one fails.
    data
        Measurements of positions or poses, in any form that `cellcal identify` reads, for the topic `real`; the two
        series of a UR10 that ship if not given.
    robot
        Nominal model that `--data` was measured on.
    out
        Folder for bench.json and a plot of each topic (PNG and SVG).
    peer_python
        NAME=PATH: the interpreter that has a peer, where its needs and ours do not go together.
    seed
        Of the simulated arm, postures and noise.
    rounds
        How often all take their turn; the best time of each counts.
    as_json
        Print one JSON object on standard output.
    """
    if reference:
        return _run_reference(out, as_json=as_json)
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.bench.contestants import parse_interpreters
    from cellcal.service.engineering.bench.results import as_document
    from cellcal.service.engineering.bench.topics import choose_topics

    interpreters = parse_interpreters(peer_python)
    chosen = choose_topics(only)
    if data is not None:
        from functools import partial

        from cellcal.service.engineering.bench.real import read_series, run_real

        chosen["real"] = partial(run_real, series=(read_series(data, robot),))
    topics = []
    for name, topic in chosen.items():
        STDERR_CONSOLE.print(f"bench: {name} …", markup=False)
        topics.append(topic(seed, max(1, rounds), interpreters))
    document = as_document(tuple(topics), seed, rounds)
    if out is not None:
        from cellcal.service.engineering.bench.plots import write_results

        for path in write_results(document, tuple(topics), out):
            STDERR_CONSOLE.print(f"wrote {path}", markup=False)
    if as_json:
        print_json(document)
    else:
        _print_topics(_wide_console(), tuple(topics))
    return 0


def _run_reference(out: Path | None, *, as_json: bool) -> int:
    from rich.console import Console

    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.engineering.bench.reference import as_document, check_all
    from cellcal.service.exit_codes import ExitCode

    found = check_all()
    document = as_document(found)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        path = out / "reference.json"
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        STDERR_CONSOLE.print(f"wrote {path}", markup=False)
    if as_json:
        print_json(document)
    else:
        _print_reference(Console(highlight=False, emoji=False), found)
    return int(ExitCode.PASS if document["passed"] else ExitCode.OUT_OF_TOLERANCE)


def _wide_console() -> "Console":
    """Return a console on which a row of the table is a line, where output is not a terminal."""
    from rich.console import Console

    console = Console(highlight=False, emoji=False)
    return console if console.is_terminal else Console(highlight=False, width=_FILE_WIDTH, emoji=False)


def _print_reference(console: "Console", found: "tuple[ReferenceComparison, ...]") -> None:
    from cellcal.calibration.reference_data import load_reference
    from cellcal.service.cli.printing import PlainTable

    for problem in dict.fromkeys(each.problem for each in found):
        document = load_reference(problem)
        table = PlainTable(
            "posed", "answer", "numbers", "difference", "tolerance", "", title=document["title"]
        )
        for each in found:
            if each.problem == problem:
                verdict = Text("pass", style="green") if each.passed else Text("FAIL", style="red")
                sizes = (f"{each.difference:.1e}", f"{each.tolerance:.0e}")
                table.add_row(each.posed, each.answer, str(each.numbers), *sizes, verdict)
        console.print(table)
        console.print(f"[dim]answers by {escape(str(document['solver']))}[/]")
    failed = sum(not each.passed for each in found)
    console.print(f"{len(found)} comparisons, {failed} failed.")


def _print_topics(console: "Console", topics: tuple["BenchTopic", ...]) -> None:
    from rich.markup import escape

    from cellcal.service.cli.printing import PlainTable

    for topic in topics:
        table = PlainTable(
            "case", "contestant", title=f"{topic.name}: {topic.question}", title_justify="left"
        )
        for heading in ("processor time (ms)", "x cellcal's time", "figure"):
            table.add_column(heading, justify="right", no_wrap=True)
        table.add_column("notes")
        for result in sorted(topic.results, key=lambda each: (each.case, each.seconds / each.count)):
            ratio = topic.speed_ratio(result)
            notes = ", ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in result.notes.items())
            table.add_row(
                result.case,
                result.contestant,
                f"{result.seconds * 1e3:,.4g}",
                "" if ratio is None or result.contestant == "cellcal" else f"{ratio:,.3g}",
                f"{result.error:.3g} {result.error_unit}",
                escape(notes),
            )
        console.print(table)
        for absent in topic.absent:
            console.print(
                f"[yellow]left out[/] {escape(absent.contestant.name)}: {escape(absent.reason)}",
                soft_wrap=True,
            )
