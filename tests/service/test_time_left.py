"""How long the rest of a run takes: instant steps do not hide the long ones, people are not waited for."""

import pytest

from cellcal.procedures.procedure_definition import Phase
from cellcal.procedures.progress import StepProgress
from cellcal.service.cell_process.remaining_time import RemainingTime

PHASES = (
    Phase("read"),
    Phase("ask"),
    Phase("go to pose", 10),
    Phase("capture", 10),
    Phase("check", 4),
    Phase("fit"),
)


class TimedRun:
    """A run's events at times that the test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.remaining_time = RemainingTime(PHASES, clock=lambda: self.now_s)

    def run_step(self, name: str, *takes_s: float, waits_s: float = 0.0) -> None:
        self._publish_event("started", name)
        for part, seconds in enumerate(takes_s):
            if part:
                self._publish_event("asked", name)
                self.now_s += waits_s
                self._publish_event("answered", name)
            self.now_s += seconds
        self._publish_event("finding", name)

    def _publish_event(self, kind: str, name: str) -> None:
        self.remaining_time.record_progress(StepProgress(kind, name, 1, 27))


def test_nothing_is_reported_before_a_step_of_many_was_seen():
    timed_run = TimedRun()
    timed_run.run_step("read", 0.01)
    timed_run.run_step("ask", 0.0, 0.01, waits_s=300.0)
    assert timed_run.remaining_time.estimate_seconds() is None


def test_a_phase_that_is_seen_tells_its_rest_and_one_that_is_not_is_taken_to_be_like_them():
    timed_run = TimedRun()
    timed_run.run_step("read", 0.01)
    timed_run.run_step("go to pose 1", 60.0)
    assert timed_run.remaining_time.estimate_seconds() == pytest.approx(9 * 60.0 + 10 * 60.0 + 4 * 60.0)
    timed_run.run_step("capture 1", 4.0)
    assert timed_run.remaining_time.estimate_seconds() == pytest.approx(9 * 60.0 + 9 * 4.0 + 4 * 32.0)


def test_waiting_for_people_counts_nothing_and_what_was_done_before_a_restart_is_done():
    timed_run = TimedRun()
    timed_run.run_step("go to pose 1", 20.0, 40.0, waits_s=900.0)
    for k in range(2, 6):
        timed_run.remaining_time.record_progress(StepProgress("replayed", f"go to pose {k}", 1, 27))
    assert timed_run.remaining_time.estimate_seconds() == pytest.approx(5 * 60.0 + 10 * 60.0 + 4 * 60.0)


def test_at_the_end_nothing_is_left_and_more_steps_than_expected_do_no_harm():
    timed_run = TimedRun()
    for name, count in (("go to pose", 10), ("capture", 10), ("check", 6)):
        for k in range(1, count + 1):
            timed_run.run_step(f"{name} {k}", 2.0)
    assert timed_run.remaining_time.estimate_seconds() == pytest.approx(0.0)
