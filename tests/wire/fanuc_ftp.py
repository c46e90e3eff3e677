"""Fake controllers behind FTP for tests: an event loop in a thread of its own, as a cabinet is a computer of its own."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.fake_devices.fanuc_files.ftp_server import HOST, FanucFtpServer


def address_of(server: FanucFtpServer) -> str:
    return f"{HOST}:{server.port}"


@contextmanager
def ftp_controllers(*cabinets: FanucCabinet) -> Iterator[list[FanucFtpServer]]:
    """Serve each cabinet on a port of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="fake controllers")
    thread.start()
    servers = [FanucFtpServer(cabinet) for cabinet in cabinets]
    try:
        with ExitStack() as stack:
            for server in servers:
                asyncio.run_coroutine_threadsafe(server.__aenter__(), loop).result(timeout=30)
                stack.callback(
                    lambda each=server: asyncio.run_coroutine_threadsafe(each.__aexit__(), loop).result(30)
                )
            yield servers
    finally:
        asyncio.run_coroutine_threadsafe(end_tasks(), loop).result(timeout=30)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(timeout=30)
        loop.close()


async def end_tasks() -> None:
    others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


def save_backup(cabinet: FanucCabinet, folder: Path, *, upper: bool = False, ending: str = "\r\n") -> Path:
    """Write every file of a controller into a folder, as a backup holds them."""
    folder.mkdir(parents=True, exist_ok=True)
    server = FanucFtpServer(cabinet)
    for name in server.list_names():
        content = server.file_bytes(name)
        assert content is not None
        text = content.decode("cp437").replace("\r\n", ending)
        (folder / (name.upper() if upper else name)).write_bytes(text.encode("cp437"))
    return folder
