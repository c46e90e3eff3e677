"""The solver's process: one question a line in, one answer a line out. Heavy imports happen here and nowhere else."""

import logging
import sys
from collections.abc import Callable, Mapping
from typing import Any

import orjson
from pydantic_core import to_jsonable_python

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CellError
from cellcal.calibration.message_table import with_messages
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.path_redaction import without_paths
from cellcal.service.review.displacement import compute_displacement
from cellcal.service.review.reviewer import Reviewer
from cellcal.service.review.tcp_uncertainty import tip_uncertainty
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_log = logging.getLogger(__name__)
_BROKEN = {
    "code": "solver",
    "message": "The computation failed; the service's log has the cause.",
    "remedy": "",
}


def make_handlers(config: CellConfig) -> Mapping[str, Callable[..., Any]]:
    """Return what can be asked, by name."""
    reviewer = Reviewer(config)
    return {
        "review": reviewer.review_run,
        "displacement": lambda **arguments: compute_displacement(config, **arguments),
        "tool doubt": lambda **arguments: tip_uncertainty(config, reviewer, **arguments),
    }


def answer_to(handlers: Mapping[str, Callable[..., Any]], line: bytes) -> dict[str, object]:
    """Return the answer to one line, or why there is none."""
    question = parse_json(line)
    try:
        return {"ok": True, "answer": to_jsonable_python(handlers[question["question"]](**question["given"]))}
    except CellError as error:
        texts = {"message": without_paths(error.message), "remedy": without_paths(error.remedy)}
        return {"ok": False, "code": error.code, **texts}
    except Exception:  # noqa: BLE001  whatever it was, the next question is answered
        _log.exception("%s broke", question["question"])
        return {"ok": False, **_BROKEN}


def answer_questions(make: Callable[[CellConfig], Mapping[str, Callable[..., Any]]]) -> None:
    """Answer until the input ends, for the cell file that is the first argument."""
    log_in_lines()
    handlers = make(read_cell_file(sys.argv[1]))
    for line in sys.stdin.buffer:
        sys.stdout.buffer.write(orjson.dumps(with_messages(answer_to(handlers, line))) + b"\n")
        sys.stdout.buffer.flush()


def main() -> None:
    """Answer questions about finished runs."""
    answer_questions(make_handlers)


if __name__ == "__main__":
    sys.exit(run_guarded(main))
