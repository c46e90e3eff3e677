"""How a run ended, as a terminal tells it: the verdict, what keeps it from being PASS, and the certificate."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellcal.service.configuration.cell_file import CellConfig
    from cellcal.service.record.run_outcome import RunOutcome

_WORDS = {
    "passed": "passed",
    "out_of_tolerance": "out of tolerance",
    "refused": "refused",
    "cell_failed": "broken off",
    "cancelled": "cancelled",
    "declined": "declined",
}


def print_outcome(outcome: "RunOutcome", config: "CellConfig", *, as_json: bool) -> int:
    """Print how a run ended, write its certificate or the record of its refusal, and return its exit code."""
    from pydantic_core import to_jsonable_python
    from rich.markup import escape

    from cellcal.service.cli.certificate import issue_after_run
    from cellcal.service.cli.printing import STDERR_CONSOLE, print_json
    from cellcal.service.exit_codes import exit_code_named, exit_code_of_word
    from cellcal.service.record.run_outcome import RunVerdict

    passed = outcome.verdict is RunVerdict.PASSED
    if not as_json:
        colour = "green" if passed else "red"
        STDERR_CONSOLE.print(
            f"[bold {colour}]{_WORDS[outcome.verdict]}[/] {outcome.procedure}, run {outcome.run_id}"
        )
        for line in (outcome.reason, f"What to do: {outcome.remedy}" if outcome.remedy else ""):
            if line:
                STDERR_CONSOLE.print(escape(line))
        print_judgement(outcome.judgement)
    is_certified = passed or outcome.verdict in (RunVerdict.REFUSED, RunVerdict.OUT_OF_TOLERANCE)
    issued = issue_after_run(config, outcome.run_id) if is_certified else None
    if as_json:
        path = None if issued is None else str(issued.json_path)
        print_json({**to_jsonable_python(outcome), "certificate": path})
    return (
        exit_code_of_word((outcome.judgement or {}).get("word")) if passed else exit_code_named(outcome.code)
    )


def print_judgement(judgement: Any) -> None:
    """Print the verdict, what keeps it from being PASS, and its remarks: what was saved among them."""
    from rich.markup import escape

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.quantities import format_quantity

    if judgement is None:
        return
    word = judgement["word"]
    colour = {"pass": "green", "fail": "red"}.get(word, "yellow")
    STDERR_CONSOLE.print(f"verdict: [bold {colour}]{word.upper()}[/] ({escape(judgement['limits_from'])})")
    for figure in judgement["characteristics"]:
        if figure["decision"] in ("fail", "undecided"):
            unit, limit = figure["unit"], figure["limit"]
            found = f"{figure['name']}: {format_quantity(figure['value'], unit)}"
            found += "" if limit is None else f", limit {format_quantity(limit, unit)}"
            STDERR_CONSOLE.print(escape(f"  {figure['decision'].upper()} {found}. {figure['rule']}"))
    for line in judgement["remarks"]:
        STDERR_CONSOLE.print(escape(f"  {line}"))
    for line in judgement["to_sign"]:
        STDERR_CONSOLE.print(f"[bold yellow]to be signed by hand:[/] {escape(line)}")
