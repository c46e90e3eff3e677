"""The command ``cellcal``."""

import sys


def main() -> None:
    """Run the command line; the only place that ends the process."""
    from service.cli.app import run_command_line  # noqa: PLC0415 - `cellcal --help` must not wait for numpy

    sys.exit(run_command_line(sys.argv[1:]))


if __name__ == "__main__":
    main()
