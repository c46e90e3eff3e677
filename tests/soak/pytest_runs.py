"""Tests of the usual suite, run by campaigns in a process of their own."""

import os
import subprocess
import sys


def run_tests(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run pytest with these words and more in its environment; half an hour is left to each test."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:randomly", "--timeout", "1800", *words]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False)
