"""Processes that a command forks to share its work among the processors: how they begin and end."""

import multiprocessing
import os
import signal
import threading


def processor_count() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def prepare_process() -> None:
    """Prepare a process: what ends the command ends it at its next share, `kill` at once.

    The handlers that it inherits run in Python, which a process that waits for a lock may never come to.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_the_command, daemon=True).start()


def _end_with_the_command() -> None:
    command = multiprocessing.parent_process()
    assert command is not None
    command.join()
    os._exit(1)
