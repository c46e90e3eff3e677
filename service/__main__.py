"""The command ``cellcal``."""

import os
import signal
import sys


def main() -> None:
    """Run the command line; the only place that ends the process."""
    # Our matrices are small: a second BLAS thread costs more than it brings, on a loaded machine tenfold.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from service.cli.app import run_command_line  # noqa: PLC0415 - `cellcal --help` must not wait for numpy

    # `kill` and a service manager end a command as Ctrl+C does: the robot is stopped, the end is journalled.
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    sys.exit(run_command_line(sys.argv[1:]))


if __name__ == "__main__":
    main()
