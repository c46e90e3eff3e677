"""A child that does everything a vendor library has been seen to do, and worse."""

import ctypes
import os
import signal
import sys
from typing import NoReturn

from cellcal.drivers.wire.child import serve_requests


def _echo(value: object) -> object:
    return value


def _refuse() -> NoReturn:
    raise RuntimeError("One of the input registers is in use")


def _bug() -> NoReturn:
    raise KeyError("a bug of ours")


def _hang_holding_the_interpreter() -> None:
    ctypes.PyDLL(None).pause()  # PyDLL keeps the interpreter's lock, as ur-rtde's constructors do


def _spin() -> NoReturn:
    while True:
        pass


def _segfault() -> None:
    ctypes.string_at(0)


def _kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _print(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _shout() -> None:
    os.write(int(sys.argv[-1]), b"\xff\xff\xff\xffnot a frame")


if __name__ == "__main__":
    serve_requests(
        {
            "echo": _echo,
            "refuse": _refuse,
            "bug": _bug,
            "hang": _hang_holding_the_interpreter,
            "spin": _spin,
            "segfault": _segfault,
            "kill": _kill,
            "print": _print,
            "shout": _shout,
        }
    )
