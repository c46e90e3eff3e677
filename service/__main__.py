"""The command ``cellcal``."""

import os
import signal
import sys
from types import FrameType

from cellcal.service.cli.overview import answer_at_once
from cellcal.service.gc_freeze import collect_rarely


def main() -> None:
    """Run the command line; the only place that ends the process."""
    if answer_at_once(sys.argv[1:]):
        sys.exit(0)
    # Our matrices are small: a second BLAS thread costs more than it brings, on a loaded machine tenfold.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    collect_rarely()
    from cellcal.service.cli.app import run_command_line  # noqa: PLC0415 - `cellcal --help` must not wait for numpy

    # `kill` and a service manager end a command as Ctrl+C does: the robot is stopped, the end is journalled.
    signal.signal(signal.SIGTERM, _as_ctrl_c)
    sys.exit(run_command_line(sys.argv[1:]))


def _as_ctrl_c(number: int, frame: FrameType | None) -> None:
    del number, frame
    # A script's shell lets what it puts behind `&` ignore Ctrl+C.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)


if __name__ == "__main__":
    main()
