"""The topics of a benchmark by name."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeAlias

from cellcal.service.engineering.bench.compensate import run_compensate
from cellcal.service.engineering.bench.contestants import BenchError
from cellcal.service.engineering.bench.identify import run_identify
from cellcal.service.engineering.bench.poses import run_poses
from cellcal.service.engineering.bench.real import run_real
from cellcal.service.engineering.bench.results import BenchTopic

TopicRun: TypeAlias = Callable[[int, int, Mapping[str, Path]], BenchTopic]
TOPICS: dict[str, TopicRun] = {
    "identify": run_identify,
    "compensate": run_compensate,
    "poses": run_poses,
    "real": run_real,
}


def choose_topics(only: str) -> dict[str, TopicRun]:
    """Return the topics named, in their own order, or all."""
    chosen = [word.strip() for word in only.split(",") if word.strip()] or list(TOPICS)
    unknown = [word for word in chosen if word not in TOPICS]
    if unknown:
        raise BenchError(f"there is no topic {unknown[0]}.", remedy=f"Topics are {', '.join(TOPICS)}.")
    return {name: topic for name, topic in TOPICS.items() if name in chosen}
