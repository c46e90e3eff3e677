"""Doing a run again from one of its steps: what is discarded is asked first, and stays in the journal."""

from difflib import get_close_matches

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Instruction, Operator
from cellcal.procedures.run import DeclinedError
from cellcal.procedures.run_history import EventKind, StepEffect
from cellcal.service.record.journal import Journal, StoreError
from cellcal.service.record.run_outcome import RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.runs.journal_ledger import forget_from

DISCARD = "discard_findings"
_MOST_NAMED = 6


async def discard_from(operator: Operator, journal: Journal, run_id: str, step: str) -> None:
    """Let findings from ``step`` on no longer count, once a person has agreed to exactly that.

    Raises
    ------
    StoreError
        The run is finished, or has no such step; the remedy names the nearest.
    DeclinedError
        The person said no; nothing was discarded.
    """
    view = RunStore(journal).find_run(run_id)
    names = [finding.step for finding in view.past.findings]
    if view.state == RunVerdict.PASSED:
        raise StoreError(
            make_message(
                "run {run_id} is finished: its result is stored, and a certificate may be out", run_id=run_id
            ),
            code="store.finished",
            remedy=make_message("Start a new one: `cellcal run {procedure}`.", procedure=view.procedure),
        )
    if step not in names:
        near = get_close_matches(step, names, n=3, cutoff=0.4) or names[:3]
        raise StoreError(
            make_message("run {run_id} has no step {step!r} with a finding.", run_id=run_id, step=step),
            code="store.no_such_step",
            remedy=make_message(
                "Did you mean {near}? `cellcal show {run_id}` lists all.",
                near=", ".join(map(repr, near)),
                run_id=run_id,
            )
            if near
            else "Nothing was found yet: resume it without --from.",
        )
    question = Instruction(
        DISCARD, _redo_question(names[names.index(step) :], _written_steps(journal, run_id))
    )
    try:
        answer = await operator.confirm(question)
    except RefusedError as error:
        raise DeclinedError(
            "the answer was no: nothing was discarded.", remedy="Resume without --from to keep all findings."
        ) from error
    forget_from(journal, run_id, step, actor=answer.who)


def _redo_question(discarded: list[str], written: frozenset[str]) -> str:
    named = (
        discarded if len(discarded) <= _MOST_NAMED else [*discarded[: _MOST_NAMED - 1], "…", discarded[-1]]
    )
    text = make_message(
        "{discarded_count} findings of this run will no longer count and will be done again: "
        "{named}. The journal keeps them. The robot stands where the run left it, not where that "
        "step began: the way from here was not checked. Bring it near the place where that step "
        "begins. ",
        discarded_count=len(discarded),
        named=", ".join(named),
    )
    touched = [step for step in discarded if step in written]
    if touched:
        written_text = make_message(
            "What {steps} wrote to the controller stays until it is written again. ", steps=", ".join(touched)
        )
        text = join_messages("", (text, written_text))
    return make_message("{text}Discard them?", text=text)


def _written_steps(journal: Journal, run_id: str) -> frozenset[str]:
    bodies = [
        parse_json(event.body) for event in journal.list_events(run_id) if event.kind == EventKind.INTENT
    ]
    return frozenset(body["step"] for body in bodies if body["effect"] == StepEffect.WRITE)
