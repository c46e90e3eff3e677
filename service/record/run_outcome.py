"""How a run ended: its verdict, its result or evidence, and what to do next."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from cellcal.calibration.errors import CalibrationError, CellError
from cellcal.procedures.procedure_definition import ProcedureDefinition
from cellcal.procedures.run import (
    DeclinedError,
    NeedsUnmetError,
    OutOfToleranceError,
    RefusalError,
    ReplayMismatchError,
)
from cellcal.service.record.run_store import RunView


class RunVerdict(StrEnum):
    """The outcome of a run."""

    PASSED = "passed"
    OUT_OF_TOLERANCE = "out_of_tolerance"
    REFUSED = "refused"
    CELL_FAILED = "cell_failed"
    CANCELLED = "cancelled"
    DECLINED = "declined"


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """The end of a run. ``result`` is the procedure's result, or the evidence of a refusal."""

    run_id: str
    procedure: str
    verdict: RunVerdict
    result: Any = None
    reason: str = ""
    remedy: str = ""
    code: str = ""
    judgement: Any = None  # what a finished procedure claims (procedures/verdict.py), as JSON values


def failed_outcome(run_id: str, procedure: str, error: CellError) -> RunOutcome:
    """Return the end of a run by an error; a refusal brings its evidence."""
    evidence = error.evidence if isinstance(error, RefusalError) else None
    return RunOutcome(
        run_id, procedure, _verdict_of(error), evidence, error.message, error.remedy, error.code
    )


def _verdict_of(error: CellError) -> RunVerdict:
    if isinstance(error, DeclinedError):
        return RunVerdict.DECLINED
    if isinstance(error, OutOfToleranceError):
        return RunVerdict.OUT_OF_TOLERANCE
    if isinstance(error, RefusalError | ReplayMismatchError | NeedsUnmetError | CalibrationError):
        return RunVerdict.REFUSED
    return RunVerdict.CELL_FAILED


def stored_outcome(view: RunView, entry: ProcedureDefinition) -> RunOutcome:
    """Return the end of a run that passed before."""
    result = entry.result_codec().validate_python(view.result)
    state = RunVerdict(view.state)
    return RunOutcome(view.run_id, view.procedure, state, result, view.reason, judgement=view.judgement)
