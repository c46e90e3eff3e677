"""For all tests: Ctrl+C interrupts what they start, time limits fit this machine, and failures do not outlive them."""

import gc
import signal
from collections.abc import Iterator

import pytest

from cellcal.drivers.supervision import SUPERVISOR
from tests.long_tests import mark_long_tests, names_without_test, read_long_tests
from tests.machine_speed import publish_slowness, stretch_test_timeouts

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a run in the background; children would ignore it
    signal.signal(signal.SIGINT, signal.default_int_handler)


# Collection makes objects that all stay: looking for garbage among them takes a quarter of its time.
gc.disable()


def pytest_configure(config: pytest.Config) -> None:
    """Measure the machine before the workers of a parallel run start."""
    publish_slowness()
    stretch_test_timeouts(config)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests that take long, before tests are chosen by their marks."""
    names = read_long_tests()
    whole_files = not any("::" in argument for argument in config.args)
    if whole_files and (unknown := names_without_test(items, names)):
        raise pytest.UsageError(f"tests/long_tests.txt names tests that do not exist: {unknown}")
    mark_long_tests(items, names)


def pytest_collection_finish() -> None:
    """Look for garbage from here on, but not among the tests that were collected."""
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def forget_failures() -> Iterator[None]:
    """Forget what a test made fail in this process: pages of the next test would show it for a minute."""
    yield
    for trouble in SUPERVISOR.list_troubles():
        SUPERVISOR.note_end(trouble.task)
