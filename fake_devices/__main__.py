"""``python -m cellcal.fake_devices CELL.toml``: play every device that the file names, until told to end.

Imitates
    The main switch of a cell.
Source
    Ours.
Modelled
    One process, one event loop, one world for all devices of one file.
Not modelled
    Devices spread over several processes.

Prints one JSON line when ready: ``{"ready": true, "control": [host, port]}``. Ends on SIGTERM or SIGINT,
and with ``--watch-stdin`` also when standard input closes, so that no fake outlives its parent process.
"""

import argparse
import asyncio
import json
import os
import signal
import sys
from pathlib import Path

from cellcal.fake_devices.cell import FakeCell
from cellcal.fake_devices.control_server import ControlServer


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m cellcal.fake_devices", description="Play the devices of a cell file."
    )
    parser.add_argument("cell", type=Path, help="the cell file")
    parser.add_argument("--arms", type=Path, help="JSON: arms that the fakes do not know, by their robots")
    parser.add_argument("--ready-fd", type=int, default=1, help="where to write the ready line (default: 1)")
    parser.add_argument("--watch-stdin", action="store_true", help="end when standard input closes")
    arguments = parser.parse_args()
    try:
        asyncio.run(play_cell(arguments.cell, arguments.ready_fd, arguments.watch_stdin, arguments.arms))
    except (OSError, ValueError, KeyError) as error:
        sys.stderr.write(f"the fake devices of {arguments.cell} cannot start: {error}\n")
        return 2
    except Exception as error:  # noqa: BLE001  the last line of defence: a sentence, never a trace
        sys.stderr.write(f"the fake devices of {arguments.cell} broke: {type(error).__name__}: {error}\n")
        return 70
    return 0


async def play_cell(
    path: Path, ready_fd: int = 1, watch_stdin: bool = False, arms: Path | None = None
) -> None:
    """Play the cell until a signal or the end of standard input."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    async with FakeCell.from_file(path, arms) as cell, ControlServer(cell) as door:
        if watch_stdin:
            await _end_with_stdin(loop, ended)
        line = json.dumps({"ready": True, "control": [door.host, door.port]})
        os.write(ready_fd, line.encode() + b"\n")
        await ended.wait()


async def _end_with_stdin(loop: asyncio.AbstractEventLoop, ended: asyncio.Event) -> None:
    class StdinWatch(asyncio.Protocol):
        def connection_lost(self, exc: Exception | None) -> None:
            ended.set()

        def eof_received(self) -> bool:
            ended.set()
            return False

    await loop.connect_read_pipe(StdinWatch, sys.stdin)


if __name__ == "__main__":
    sys.exit(main())
