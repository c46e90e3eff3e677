"""For all tests: what they start is interrupted by Ctrl+C, and time limits fit the speed of this machine."""

import signal

import pytest

from tests.machine_speed import publish_slowness, stretch_test_timeouts

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a run in the background; children would ignore it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Measure the machine before the workers of a parallel run start."""
    publish_slowness()
    stretch_test_timeouts(config)
