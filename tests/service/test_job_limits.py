"""A job whose programs take too much memory or computing ends in one sentence, and the service goes on."""

import itertools
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.engineering.programs.jobs.jobs import Jobs
from cellcal.service.engineering.programs.jobs.limits import Limits
from tests.service.test_programs_api import CELL_7, SOURCES, an_engineer, run_job, uploaded_files

COMPENSATION = {"do": "compensate", "cell": CELL_7, "files": uploaded_files(SOURCES)}
ENOUGH = Limits()


async def ended(folder: Path, limits: Limits, **wanted: Any) -> dict[str, Any]:
    async with an_engineer(folder) as door:
        door.app.state.programs = Jobs(read_cell_file(door.app.state.context.settings.cell_file), limits)
        return await run_job(door, **(COMPENSATION | wanted))


def a_large_program() -> bytes:
    head, _, rest = next(iter(SOURCES.values())).partition(b"/POS\n")
    points, _, _ = rest.partition(b"/END")
    numbers = itertools.count(1)
    many = re.sub(rb"P\[\d+", lambda _: b"P[%d" % next(numbers), points * (5_000_000 // len(points)))
    return head + b"/POS\n" + many + b"/END\n"


async def test_one_that_takes_too_much_memory_says_so(tmp_path: Path) -> None:
    answer = await ended(
        tmp_path, Limits(memory_bytes=130 << 20), files=uploaded_files({"BIG.LS": a_large_program()})
    )
    assert answer["state"] == "failed"
    assert "more than 130 MB of memory" in answer["fault"]["message"], answer
    assert answer["fault"]["remedy"]


async def test_one_that_computes_for_too_long_says_so(tmp_path: Path) -> None:
    answer = await ended(tmp_path, Limits(cpu_s=1), files=uploaded_files({"BIG.LS": a_large_program()}))
    assert answer["state"] == "failed"
    assert "more than 1 s of computing" in answer["fault"]["message"], answer


async def test_the_usual_job_stays_inside(tmp_path: Path) -> None:
    assert (await ended(tmp_path, ENOUGH))["state"] == "done"


@pytest.mark.parametrize(
    ("code", "words"),
    [(-signal.SIGKILL, "ended from outside"), (-signal.SIGSEGV, "by itself"), (1, "by itself")],
)
def test_however_a_process_ends_there_is_one_sentence(code: int, words: str) -> None:
    message, remedy = ENOUGH.words_of_end(code)
    assert words in message
    assert message.count(".") == 1
    assert remedy
