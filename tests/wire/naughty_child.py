"""A child that does everything a vendor library has been seen to do, and worse."""

import ctypes
import os
import signal
import sys
from typing import NoReturn

from cellcal.drivers.wire.child import serve_requests


def _echo_value(value: object) -> object:
    return value


def _refuse_call() -> NoReturn:
    raise RuntimeError("One of the input registers is in use")


def _raise_bug() -> NoReturn:
    raise KeyError("a bug of ours")


def _hang_holding_the_interpreter() -> None:
    ctypes.PyDLL(None).pause()  # PyDLL keeps the interpreter's lock, as ur-rtde's constructors do


def _spin_forever() -> NoReturn:
    while True:
        pass


def _cause_segfault() -> None:
    ctypes.string_at(0)


def _kill_self() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _print_text(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _flood_output() -> None:
    os.write(int(sys.argv[-1]), b"\xff\xff\xff\xffnot a frame")


if __name__ == "__main__":
    serve_requests(
        {
            "echo": _echo_value,
            "refuse": _refuse_call,
            "bug": _raise_bug,
            "hang": _hang_holding_the_interpreter,
            "spin": _spin_forever,
            "segfault": _cause_segfault,
            "kill": _kill_self,
            "print": _print_text,
            "shout": _flood_output,
        }
    )
