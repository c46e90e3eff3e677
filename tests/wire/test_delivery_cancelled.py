"""A delivery that is cancelled while a file is being written: what is signed is what is there."""

import asyncio
import ftplib
import os
import threading
from pathlib import Path
from typing import Any

import pytest

from cellcal.drivers.wire.cancellation import run_in_thread_to_end
from cellcal.service.engineering.delivery.deliveries import Approval, deliver_programs
from cellcal.service.engineering.delivery.store_addresses import OpenStore, StoreLogin, store_at
from cellcal.service.engineering.delivery.stored_copies import DeliveryState, read_delivery
from tests.wire.writable_ftp import PASSWORD, USER, writable_ftp

LISTING = b"/PROG  WELD\r\n/ATTR\r\n/MN\r\n   1:  R[1]=%d    ;\r\n/POS\r\n/END\r\n"


class SlowWrite:
    """The first write of a thread waits until it is released."""

    def __init__(self) -> None:
        self.begun, self.released = threading.Event(), threading.Event()

    def wait_once(self) -> None:
        if not self.begun.is_set():
            self.begun.set()
            assert self.released.wait(30)


async def _cancel_while_writing(
    open_store: OpenStore, new: dict[str, bytes], copies: Path, slow: SlowWrite
) -> DeliveryState:
    """Cancel a delivery in its first write, which goes on afterwards; return what its document says."""
    delivery = asyncio.create_task(
        deliver_programs(open_store, new, copies, Approval("Eva", robot_stands=True), "x")
    )
    assert await asyncio.to_thread(slow.begun.wait, 30)
    delivery.cancel()
    await asyncio.wait({delivery}, timeout=0.5)  # one that does not wait for its thread ends here
    slow.released.set()
    await asyncio.wait({delivery})
    assert delivery.cancelled()
    await asyncio.get_running_loop().shutdown_default_executor()  # what still writes has written
    return _signed_state(copies)


def _signed_state(copies: Path) -> DeliveryState:
    (folder,) = (entry for entry in copies.iterdir() if entry.is_dir())
    return read_delivery(folder).delivery.state


async def test_a_share_holds_the_old_program_when_a_delivery_is_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    share, slow, write_out = tmp_path / "share", SlowWrite(), os.fsync
    share.mkdir()
    (share / "a.src").write_bytes(b"OLD")

    def write_slowly(descriptor: int) -> None:
        if threading.current_thread() is not threading.main_thread():  # the copies are written in this one
            slow.wait_once()
        write_out(descriptor)

    monkeypatch.setattr(os, "fsync", write_slowly)
    open_store = store_at(str(share), StoreLogin())
    state = await _cancel_while_writing(open_store, {"a.src": b"NEW"}, tmp_path / "copies", slow)
    assert state is DeliveryState.PUT_BACK
    assert (share / "a.src").read_bytes() == b"OLD"


async def test_a_controller_holds_the_old_listing_when_a_delivery_is_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, slow, upload = tmp_path / "md", SlowWrite(), ftplib.FTP.storbinary
    folder.mkdir()
    (folder / "weld.ls").write_bytes(LISTING % 1)

    def upload_slowly(link: ftplib.FTP, command: str, file: Any) -> str:
        return upload(link, command, file, callback=lambda _: slow.wait_once(), blocksize=40)

    monkeypatch.setattr(ftplib.FTP, "storbinary", upload_slowly)
    with writable_ftp(folder) as server:
        login = StoreLogin(USER, PASSWORD, timeout_s=10.0)
        open_store = store_at(f"fanuc://127.0.0.1:{server.port}", login)
        state = await _cancel_while_writing(open_store, {"weld.ls": LISTING % 2}, tmp_path / "copies", slow)
    assert state is DeliveryState.PUT_BACK
    assert b"R[1]=1" in (folder / "weld.ls").read_bytes()


async def test_a_cancelled_call_ends_with_its_thread_and_raises_the_cancellation() -> None:
    begun, released, written = threading.Event(), threading.Event(), []

    def write() -> int:
        begun.set()
        assert released.wait(30)
        written.append(1)
        return 7

    call = asyncio.ensure_future(run_in_thread_to_end(write))
    assert await asyncio.to_thread(begun.wait, 30)
    call.cancel()
    await asyncio.sleep(0)
    call.cancel()
    released.set()
    with pytest.raises(asyncio.CancelledError):
        await call
    assert written == [1]
    assert await run_in_thread_to_end(write) == 7
