"""What a benchmark found: rows for a table, a JSON document and a plot; who was missing, and why."""

import math
import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field

from cellcal.service.engineering.bench.contestants import AbsentContestant, Answers, Contestant

_SLOW_S = 5.0  # one turn of these is enough


@dataclass(frozen=True, slots=True)
class BenchResult:
    """One contestant in one case. ``error`` is the figure of merit, in ``error_unit``."""

    contestant: str
    case: str
    count: int  # of poses or rows
    seconds: float
    error: float
    error_unit: str
    notes: dict[str, float] = field(default_factory=dict)

    @property
    def poses_per_s(self) -> float:
        """Poses a second."""
        return self.count / self.seconds


@dataclass(frozen=True, slots=True)
class BenchTopic:
    """All results of one topic, best time of the rounds each, in one run on one machine."""

    name: str
    question: str
    results: tuple[BenchResult, ...]
    absent: tuple[AbsentContestant, ...] = ()
    per_pose: bool = True  # compare rates; otherwise whole times

    def speed_ratio(self, result: BenchResult) -> float | None:
        """Return how many times as fast ours was on the same case; None where ours did not run."""
        own = [r for r in self.results if r.case == result.case and r.contestant == "cellcal"]
        if not own:
            return None
        return own[0].poses_per_s / result.poses_per_s if self.per_pose else result.seconds / own[0].seconds


def take_turns(
    contestants: Iterable[Contestant],
    rounds: int,
    run: Callable[[Contestant], Answers | AbsentContestant],
    judge: Callable[[Contestant, Answers], BenchResult],
) -> tuple[tuple[BenchResult, ...], tuple[AbsentContestant, ...]]:
    """Let all run in turn, several times, and keep each one's best time; slow ones run once."""
    best: dict[str, BenchResult] = {}
    absent: dict[str, AbsentContestant] = {}
    for _ in range(rounds):
        for each in contestants:
            if each.name in absent or (each.name in best and best[each.name].seconds > _SLOW_S):
                continue
            answers = run(each)
            if isinstance(answers, AbsentContestant):
                absent[each.name] = answers
                continue
            result = judge(each, answers)
            if each.name not in best or result.seconds < best[each.name].seconds:
                best[each.name] = result
    return tuple(best.values()), tuple(absent.values())


def as_document(topics: tuple[BenchTopic, ...], seed: int, rounds: int) -> dict[str, object]:
    """Return one JSON object with everything, the machine and its load included."""
    return {
        "machine": {
            "system": platform.platform(),
            "python": platform.python_version(),
            "processors": os.cpu_count(),
            "load": list(os.getloadavg()),
            "threads": 1,
        },
        "seed": seed,
        "rounds": rounds,
        "topics": [_topic_to_json(topic) for topic in topics],
    }


def _topic_to_json(topic: BenchTopic) -> dict[str, object]:
    rows = [
        {
            **asdict(result),
            "error": _finite_or_none(result.error),
            "notes": {key: _finite_or_none(value) for key, value in result.notes.items()},
            "rate_per_s": result.poses_per_s,
            "times_slower_than_cellcal": topic.speed_ratio(result),
        }
        for result in topic.results
    ]
    absent = [{"contestant": each.contestant.name, "reason": each.reason} for each in topic.absent]
    return {"name": topic.name, "question": topic.question, "results": rows, "absent": absent}


def _finite_or_none(value: float) -> float | None:
    """Return None for what JSON cannot hold: nothing solved has no worst error."""
    return value if math.isfinite(value) else None
