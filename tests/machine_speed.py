"""How much slower this machine is than a quiet one of two cores; time limits of the tests are stretched by it."""

import os
import subprocess
import sys
import time

import pytest

_VARIABLE = "CELLCAL_TEST_SLOWNESS"  # measured once, by the process that starts the others
_QUIET_S = 0.045  # of one measurement on a quiet machine
_MEASUREMENTS = 5
_MOST = 5.0
_OWN_LOAD = (
    2.0  # two workers with their browsers and fakes share the cores: each runs at half the speed measured
)


def measure_slowness() -> float:
    """Return how often longer a short child process takes than on a quiet machine, from 1 to 5."""
    began_s = time.monotonic()
    for _ in range(_MEASUREMENTS):
        subprocess.run([sys.executable, "-I", "-c", "sum(range(400_000))"], check=True)
    spent_s = (time.monotonic() - began_s) / _MEASUREMENTS
    return min(max(spent_s / _QUIET_S, 1.0), _MOST)


def publish_slowness() -> None:
    """Measure once and pass the figure to all processes of this test session."""
    if _VARIABLE not in os.environ:
        os.environ[_VARIABLE] = f"{_OWN_LOAD * measure_slowness():.2f}"


def stretched_s(seconds: float) -> float:
    """Return a time limit [s] that this machine can keep, beside all the tests, if a quiet one keeps ``seconds``."""
    publish_slowness()
    return seconds * float(os.environ[_VARIABLE])


def stretch_test_timeouts(config: pytest.Config) -> None:
    """Stretch the limit after which a hanging test is ended."""
    limit = config.getini("timeout")
    if limit and config.getoption("timeout", None) is None:
        config.option.timeout = stretched_s(float(limit))
