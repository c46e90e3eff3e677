"""``cellcal run | runs | show | resume``: do it, and look at what was done."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.text import Text

from cellcal.calibration.documents.json_text import parse_json

if TYPE_CHECKING:
    from cellcal.service.configuration.cell_file import CellConfig
    from cellcal.service.record.run_outcome import RunOutcome

Json = Annotated[bool, Parameter(name="--json", negative=())]


def run(  # noqa: PLR0913  a command's options are its arguments
    procedure: str,
    /,
    *,
    cell: Path,
    robot: str | None = None,
    setting: Annotated[tuple[str, ...], Parameter(name=["--set", "-s"], negative=())] = (),
    answers: Path | None = None,
    dry_run: Annotated[bool, Parameter(negative=())] = False,
    accept_missing_end: Annotated[bool, Parameter(negative=())] = False,
    as_json: Json = False,
) -> int:
    """Run a procedure on a cell, with progress; questions are asked in the terminal.

    At its end the result is judged (PASS, FAIL, UNDECIDED) and a signed certificate is written. Exit codes: 0 PASS,
    3 FAIL, 4 UNDECIDED or refused.

    Parameters
    ----------
    procedure
        A name from `cellcal procedures`.
    cell
        The cell file (TOML).
    robot
        Which robot of the cell; the first one when not said.
    setting
        KEY=VALUE of the procedure's spec, in SI units (VALUE is JSON or text); may be repeated.
    answers
        A JSON file {instruction key: answer} that answers instead of a person.
    dry_run
        Show steps, poses, duration, predicted uncertainty and what the cell lacks; touch no device.
    accept_missing_end
        Run although the end of the journal is missing (`cellcal runs` tells it).
    as_json
        Print one JSON object on standard output.
    """
    from cellcal.service.cli.procedure_preview import print_dry_run
    from cellcal.service.cli.run_arguments import settings_of
    from cellcal.service.cli.run_end import print_outcome
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.runs.run_preview import refuse_class_out_of_reach

    config, settings = read_cell_file(cell), settings_of(setting)
    if dry_run:
        return print_dry_run(config, procedure, robot, settings, as_json=as_json)
    refuse_class_out_of_reach(config, procedure, settings, robot)
    outcome = asyncio.run(
        run_live(config, procedure, robot, settings, answers, accept_missing_end=accept_missing_end)
    )
    return print_outcome(outcome, config, as_json=as_json)


def resume(  # noqa: PLR0913  a command's options are its arguments
    run_id: str,
    /,
    *,
    cell: Path,
    robot: str | None = None,
    redo_from: Annotated[str | None, Parameter(name="--from")] = None,
    answers: Path | None = None,
    accept_missing_end: Annotated[bool, Parameter(negative=())] = False,
    as_json: Json = False,
) -> int:
    """Go on with an interrupted run: what was found is kept, only what is missing is done.

    Parameters
    ----------
    run_id
        A run from `cellcal runs`, or `last`.
    cell
        The cell file (TOML); it must be the one the run was started with.
    robot
        Which robot of the cell; the first one when not said.
    redo_from
        A step of `cellcal show`: what was found from there on no longer counts and is done again. It is asked first;
        the journal keeps everything.
    answers
        A JSON file {instruction key: answer} that answers instead of a person.
    accept_missing_end
        Go on although the end of the journal is missing (`cellcal runs` tells it): what is missing is done again.
    as_json
        Print one JSON object on standard output.
    """
    from cellcal.service.cli.run_end import print_outcome
    from cellcal.service.configuration.cell_file import read_cell_file

    config = read_cell_file(cell)
    resumed = _resume_run(config, run_id, robot, answers, redo_from, accept_missing_end=accept_missing_end)
    outcome = asyncio.run(resumed)
    return print_outcome(outcome, config, as_json=as_json)


def runs(*, cell: Path, as_json: Json = False) -> int:
    """List the runs that a cell's journal holds.

    Parameters
    ----------
    cell
        The cell file (TOML).
    as_json
        Print one JSON object on standard output.
    """
    from rich.console import Console
    from rich.table import Column

    from cellcal.service.cli.printing import PlainTable, print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.runs.cell_check import journal_flaw

    with _journal(cell) as (journal, store):
        views = store.list_runs()
        config = read_cell_file(cell)
        damage, states = journal_flaw(config, journal), _states_seen(config, *views)
        pending = () if journal.damage else _list_unconfirmed(store, config)
    if as_json:
        keys = ("run_id", "procedure", "started_utc", "begun_by", "begun_as", "reason")
        rows = [
            {**{key: getattr(view, key) for key in keys}, "state": state}
            for view, state in zip(views, states, strict=True)
        ]
        print_json({"runs": rows, "unconfirmed": [run_id for _, run_id in pending]})
        return _print_damage(damage)
    table = PlainTable(
        Column("run", no_wrap=True), Column("started (UTC)", min_width=10), "by", "ended", "reason"
    )
    for view, state in zip(views, states, strict=True):
        started = view.started_utc[:19].replace("T", " ")
        ended, by = state.replace("_", " "), _begun_by(view)
        table.add_row(view.run_id, started, by, ended, view.reason)
    if views or not damage:
        Console(emoji=False).print(
            table if views else "No run yet. Begin with `cellcal run mastering_record --cell CELL`."
        )
    _print_unconfirmed(Console(emoji=False), pending)
    return _print_damage(damage)


def show(run_id: str, /, *, cell: Path, as_json: Json = False) -> int:
    """Show one run: its steps, findings and result; and whether the journal is unchanged.

    Parameters
    ----------
    run_id
        A run from `cellcal runs`, or `last`.
    cell
        The cell file (TOML).
    as_json
        Print one JSON object on standard output.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.tree import Tree

    from cellcal.service.cli.printing import print_json
    from cellcal.service.configuration.cell_file import read_cell_file
    from cellcal.service.runs.cell_check import journal_flaw

    with _journal(cell) as (journal, store):
        view = store.find_run(store.resolve_run_id(run_id))
        config = read_cell_file(cell)
        damage, events = journal_flaw(config, journal), journal.list_events(view.run_id)
        unconfirmed = () if journal.damage else _list_unconfirmed(store, config)
        pending = tuple(one for one in unconfirmed if one[1] == view.run_id)
    if as_json:
        findings = [{"step": f.step, "value": f.value} for f in view.past.findings]
        print_json(
            {
                "run_id": view.run_id, "procedure": view.procedure, "begun_by": view.begun_by,
                "begun_as": view.begun_as, "state": _states_seen(config, view)[0], "reason": view.reason,
                "spec": view.spec,
                "findings": findings, "result": view.result,
                "judgement": view.judgement, "unconfirmed": bool(pending), "in_doubt": view.past.in_doubt or "",
                "journal": damage or "unchanged",
            }
        )  # fmt: skip
        return _print_damage(damage)
    console = Console(emoji=False)
    _print_beginning(console, view, _states_seen(config, view)[0])
    console.print(_events_table(events))
    if isinstance(view.result, dict):
        tree = Tree("result")
        for key, value in view.result.items():
            tree.add(Text(f"{key}: {_shorten_text(value)}"))
        console.print(tree)
    if view.judgement is not None:
        console.print(
            f"verdict: {escape(view.judgement['word'].upper())}; `cellcal certificate` tells it whole"
        )
    _print_doubt(console, view, pending)
    if not damage:
        console.print("journal: unchanged")
    return _print_damage(damage)


def _print_beginning(console: Any, view: Any, state: str) -> None:
    from rich.markup import escape

    console.print(f"[bold]{view.procedure}[/] run {view.run_id}: {state} {escape(view.reason)}")
    roles = f" ({' and '.join(view.begun_as)})" if view.begun_as else ""
    console.print(f"begun: {escape(_begun_by(view) + roles)}, {view.started_utc[:19].replace('T', ' ')} UTC")


def _states_seen(config: "CellConfig", *views: Any) -> list[str]:
    from cellcal.service.record.journal_files import lease_folder
    from cellcal.service.record.robot_lock import runs_under_way

    under_way = runs_under_way(lease_folder(config))
    return [view.state_seen(under_way) for view in views]


def _begun_by(view: Any) -> str:
    from cellcal.service.watching.loss_response import WATCH

    if view.begun_by == WATCH:
        return "by itself"
    return str(view.begun_by)


def _events_table(events: Any) -> Any:
    from cellcal.service.cli.printing import PlainTable

    table = PlainTable("event", "time (UTC)", "kind", "step", "who")
    for event in events:
        table.add_row(str(event.seq), event.wall_utc[11:23], event.kind, _step_of(event.body), event.actor)
    return table


def _list_unconfirmed(store: Any, config: "CellConfig") -> tuple[tuple[str, str], ...]:
    """Return robots and the runs that wrote their mastering and left it neither confirmed nor undone."""
    return tuple(
        (robot.name, one.of_run) for robot in config.robots for one in store.list_unconfirmed(robot.serial)
    )


def _print_doubt(console: Any, view: Any, pending: tuple[tuple[str, str], ...]) -> None:
    """Say what a run may have done without an outcome, and what it wrote without a confirmation."""
    from rich.markup import escape

    if view.past.in_doubt and view.state != "passed":
        console.print(
            f"[bold red]Step '{escape(view.past.in_doubt)}' was broken off and may have acted since.[/] "
            "Look at the robot before anything is started."
        )
    _print_unconfirmed(console, pending)


def _print_unconfirmed(console: Any, pending: tuple[tuple[str, str], ...]) -> None:
    for name, run_id in pending:
        console.print(
            f"[bold red]{name}: the mastering that {run_id} wrote is not confirmed.[/] Do not move the robot in "
            f"AUTO; resume that run, or undo it (cellcal run mastering_undo --set of_run={run_id})."
        )


def _print_damage(damage: str) -> int:
    from rich.markup import escape

    from cellcal.service.cli.printing import STDERR_CONSOLE
    from cellcal.service.exit_codes import ExitCode

    if not damage:
        return ExitCode.PASS
    STDERR_CONSOLE.print(f"[bold red]{escape(damage)}[/]")
    return ExitCode.SIGNATURE


def _step_of(body: str) -> str:

    return str(parse_json(body).get("step", ""))


def _shorten_text(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 100 else text[:97] + "…"


class _JournalReader:
    """A cell's journal for reading."""

    def __init__(self, cell: Path) -> None:
        from cellcal.service.configuration.cell_file import read_cell_file
        from cellcal.service.record.journal_files import open_journal

        self._journal = open_journal(read_cell_file(cell))

    def __enter__(self) -> tuple[Any, Any]:
        from cellcal.service.record.run_store import RunStore

        return self._journal, RunStore(self._journal)

    def __exit__(self, *_: object) -> None:
        self._journal.close()


_journal = _JournalReader


async def run_live(
    config: "CellConfig",
    procedure: str,
    robot: str | None,
    settings: Mapping[str, object],
    answers: Path | None,
    *,
    accept_missing_end: bool = False,
) -> "RunOutcome":
    """Run a procedure with progress on standard error."""
    from cellcal.drivers.operator.terminal_user import terminal_user
    from cellcal.service.cli.progress import live_progress
    from cellcal.service.cli.run_arguments import operator_of
    from cellcal.service.runs.launch import RunTarget, start_run

    with live_progress(procedure) as show_event:
        where = RunTarget(
            config, operator_of(answers), robot, show_event, terminal_user(), accept_missing_end
        )
        return await start_run(where, procedure, settings)


async def _resume_run(
    config: "CellConfig",
    run_id: str,
    robot: str | None,
    answers: Path | None,
    redo_from: str | None,
    *,
    accept_missing_end: bool,
) -> "RunOutcome":
    from cellcal.drivers.operator.terminal_user import terminal_user
    from cellcal.service.cli.progress import live_progress
    from cellcal.service.cli.run_arguments import operator_of
    from cellcal.service.runs.launch import RunTarget, resume_run

    with live_progress("resume") as show_event:
        where = RunTarget(
            config, operator_of(answers), robot, show_event, terminal_user(), accept_missing_end
        )
        return await resume_run(where, run_id, redo_from)
