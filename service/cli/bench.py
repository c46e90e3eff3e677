"""``cellcal bench``: speed and accuracy against peers, on the same data, in one run."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from rich.console import Console

    from service.bench.results import Topic


def bench(
    *,
    only: str = "",
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
        Topics, separated by commas: identify, compensate, poses. All if not given.
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
    from rich.console import Console

    from service.bench.contestants import parse_interpreters
    from service.bench.results import as_document
    from service.bench.topics import choose_topics
    from service.cli.printing import EN_ROUTE, print_json

    interpreters = parse_interpreters(peer_python)
    topics = []
    for name, topic in choose_topics(only).items():
        EN_ROUTE.print(f"bench: {name} …")
        topics.append(topic(seed, max(1, rounds), interpreters))
    document = as_document(tuple(topics), seed, rounds)
    if out is not None:
        from service.bench.plots import write_results

        for path in write_results(document, tuple(topics), out):
            EN_ROUTE.print(f"wrote {path}")
    if as_json:
        print_json(document)
    else:
        _print(Console(highlight=False), tuple(topics))
    return 0


def _print(console: "Console", topics: tuple["Topic", ...]) -> None:
    from rich.markup import escape
    from rich.table import Table

    for topic in topics:
        table = Table(
            "case", "contestant", "time", "a second", "cellcal is faster", "figure", "notes",
            title=f"{topic.name}: {topic.question}",
        )  # fmt: skip
        for result in sorted(topic.results, key=lambda each: (each.case, each.seconds / each.count)):
            ratio = topic.ratio(result)
            notes = ", ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in result.notes.items())
            table.add_row(
                result.case,
                result.contestant,
                f"{result.seconds * 1e3:.4g} ms",
                f"{result.rate:,.0f}",
                "" if ratio is None or result.contestant == "cellcal" else f"{ratio:.3g} x",
                f"{result.error:.3g} {result.error_unit}",
                escape(notes),
            )
        console.print(table)
        for absent in topic.absent:
            console.print(
                f"[yellow]left out[/] {absent.contestant.name}: {escape(absent.reason)}", soft_wrap=True
            )
