"""Parts of an identification in several processes: the same answer as in one, whatever happens to a process."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.errors import DegenerateDataError
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.misfit_error import MisfitCause, MisfitError
from cellcal.calibration.identification.work_parts import PartRunner
from cellcal.service.engineering.forked_processes import prepare_process
from cellcal.service.engineering.identification import forked_parts
from cellcal.service.engineering.identification.forked_parts import (
    DisplayedRunner,
    ForkedRunner,
    NoDisplay,
    share_parts,
)
from tests.machine_speed import stretched_s
from tests.unit.helpers.simulated_arm import tracker_points


@dataclass
class Shown:
    """What was shown, in order."""

    stages: list[str] = field(default_factory=list)
    parts: list[tuple[int, int]] = field(default_factory=list)

    def show_stage(self, text: str) -> None:
        self.stages.append(text)

    def show_parts(self, done: int, begun: int) -> None:
        self.parts.append((done, begun))


@contextmanager
def two_processes(display=None) -> Iterator[PartRunner]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forked_parts, "processor_count", lambda: 2)
        # A worker of pytest-xdist has a thread that reads its pipe and takes no lock of ours.
        patch.setattr(threading, "active_count", lambda: 1)
        with share_parts(display or NoDisplay()) as runner:
            assert isinstance(runner, ForkedRunner)
            yield runner


def own_process() -> int:
    return os.getpid()


def end_process(parent: int) -> str:
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    return "carried out here"


def refuse() -> None:
    raise DegenerateDataError("too few rows.", remedy="Measure more.", condition=7.0)


def test_forked_processes_find_the_same_arm_to_the_last_bit() -> None:
    simulated = tracker_points("ur10", 26, seed=3)
    shown = Shown()
    with two_processes(shown) as runner:
        shared = identify_arm(simulated.model, simulated.observations, runner=runner)
    alone = identify_arm(simulated.model, simulated.observations)
    assert np.array_equal(shared.judgement.held_out_m, alone.judgement.held_out_m)
    assert np.array_equal(shared.judgement.before_m, alone.judgement.before_m)
    assert np.array_equal(shared.judgement.variances_m2, alone.judgement.variances_m2)
    assert np.array_equal(shared.robust.fit.covariance, alone.robust.fit.covariance)
    assert (shared.level, shared.level_reasons) == (alone.level, alone.level_reasons)
    assert shown.stages[0].startswith("looking for rows")
    assert shown.parts[-1][0] == shown.parts[-1][1] > 5


def test_parts_are_carried_out_in_processes_that_end_with_the_work() -> None:
    with two_processes() as runner:
        found = [runner.submit(own_process) for _ in range(20)]
        processes = {wait() for wait in found}
    assert os.getpid() not in processes
    assert len(processes) <= 2
    assert not {child.pid for child in multiprocessing.active_children()} & processes


def test_a_part_whose_process_is_killed_is_carried_out_here() -> None:
    with two_processes() as runner:
        assert runner.submit(end_process, os.getpid())() == "carried out here"
        assert runner.submit(own_process)() == os.getpid()


def test_what_a_part_raises_arrives_whole() -> None:
    with two_processes() as runner, pytest.raises(DegenerateDataError, match="too few rows") as raised:
        runner.submit(refuse)()
    assert (raised.value.remedy, raised.value.condition) == ("Measure more.", 7.0)


def refuse_misfit_with_cause() -> None:
    cause = MisfitCause(("sign",), "joint 2 turns the other way", "Give `--sign`.", 1e-4)
    raise MisfitError("the measurements do not fit.", remedy="Nothing was stored.", causes=(cause,))


def test_a_misfit_found_by_a_part_arrives_with_its_causes() -> None:
    with two_processes() as runner, pytest.raises(MisfitError, match="do not fit") as raised:
        runner.submit(refuse_misfit_with_cause)()
    assert (raised.value.remedy, raised.value.causes[0].kinds) == ("Nothing was stored.", ("sign",))


def test_an_interruption_ends_the_processes_at_once() -> None:
    children = set()

    def interrupted() -> None:
        with two_processes() as runner:
            children.update(multiprocessing.active_children())
            runner.submit(signal.pause)  # would go on for ever
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert children
    assert not children & set(multiprocessing.active_children())


def refuse_while_a_process_prepares(marker: Path) -> None:
    """Refuse at once, while one of two processes still has the handlers of the command and the other waits for work."""

    def prepare_the_first_at_once() -> None:
        with suppress(FileExistsError):
            marker.touch(exist_ok=False)
            return prepare_process()
        time.sleep(0.5)
        return prepare_process()

    signal.signal(signal.SIGTERM, lambda number, frame: None)
    with pytest.MonkeyPatch.context() as patch, suppress(DegenerateDataError):
        patch.setattr(forked_parts, "prepare_process", prepare_the_first_at_once)
        with two_processes():
            refuse()


def test_a_refusal_before_all_processes_are_prepared_ends_at_once(tmp_path: Path) -> None:
    command = multiprocessing.get_context("fork").Process(
        target=refuse_while_a_process_prepares, args=(tmp_path / "first",)
    )
    command.start()
    command.join(stretched_s(20.0))
    ended = command.exitcode
    command.kill()
    assert ended == 0


def test_one_processor_forks_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forked_parts, "processor_count", lambda: 1)
    shown = Shown()
    with share_parts(shown) as runner:
        assert isinstance(runner, DisplayedRunner)
        wait = runner.submit(own_process)
        assert wait() == os.getpid()
    assert shown.parts == [(1, 1)]


def test_a_process_with_threads_is_not_forked() -> None:
    let_go = threading.Event()
    other = threading.Thread(target=let_go.wait, daemon=True)
    other.start()
    try:
        with share_parts(NoDisplay()) as runner:
            assert isinstance(runner, DisplayedRunner)
    finally:
        let_go.set()
        other.join()


def test_a_part_gets_what_it_was_given_though_it_is_changed_before_a_process_is_free():
    with two_processes() as runner:
        busy = [runner.submit(time.sleep, 0.05) for _ in range(12)]  # more than the pool takes at once
        options = {"level": 1}
        waits = runner.submit(dict, options)
        options["level"] = 2
        options.update({str(number): number for number in range(1000)})
        assert waits() == {"level": 1}
        for wait in busy:
            wait()
