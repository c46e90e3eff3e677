"""Programs of Universal Robots controllers over SFTP: a pinned key, the dashboard's word, all or nothing."""

import asyncio
import random
import re
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from cellcal.drivers.errors import DeviceError, RefusedError, UnreachableError, WireProtocolError
from cellcal.fake_devices.listening_port import ListeningPort
from cellcal.service.engineering.delivery.comparison import fetch_programs, folders_below
from cellcal.service.engineering.delivery.deliveries import (
    Approval,
    DeliveryFailedError,
    DeliveryRefusedError,
    deliver_programs,
    restore_programs,
)
from cellcal.service.engineering.delivery.store_addresses import StoreLogin, store_at
from cellcal.service.engineering.delivery.stored_copies import DeliveryState, StoredDelivery, read_delivery
from tests.machine_speed import stretched_s
from tests.wire.cutting_proxy import CuttingProxy
from tests.wire.writable_sftp import PASSWORD, WritableSftp, writable_sftp

EVA, STANDS = Approval("Eva"), Approval("Eva", robot_stands=True)
OLD = {"weld.urp": b"\x1f\x8b old", "weld.script": b"def weld():\nend\n"}
NEW = {
    "weld.urp": b"\x1f\x8b moved" + bytes(range(256)) * 2000,  # more than one part
    "weld.script": b"def weld():\n  # moved\nend\n",
    "added.script": b"def added():\nend\n",
}
DEADLINE_S = stretched_s(10.0)


class Dashboard:
    """The dashboard of one controller; it answers with ``state``."""

    def __init__(self) -> None:
        self.state = "STOPPED weld.urp"

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"Connected: Universal Robots Dashboard Server\n")
        question = (await reader.readline()).strip()
        writer.write((self.state if question == b"programState" else "could not understand").encode() + b"\n")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = tmp_path / "controller"
    (root / "programs").mkdir(parents=True)
    for name, content in OLD.items():
        (root / "programs" / name).write_bytes(content)
    (root / "programs" / "weld.urp").chmod(0o750)
    (root / "programs" / "sub.script").mkdir()
    (root / "programs" / "notes.pdf").write_bytes(b"%PDF")
    return root


@pytest.fixture
async def controller(root: Path) -> AsyncIterator[SimpleNamespace]:
    dashboard = Dashboard()
    server = await start_on_free_loopback(dashboard)
    host = server.host
    async with server, writable_sftp(root, host) as sftp:
        yield SimpleNamespace(
            host=host, dashboard=dashboard, server=server, sftp=sftp, folder=root / "programs"
        )


async def start_on_free_loopback(dashboard: Dashboard) -> ListeningPort:
    rng = random.SystemRandom()
    for _ in range(20):
        host = f"127.{rng.randint(1, 250)}.{rng.randint(0, 250)}.{rng.randint(1, 250)}"
        port = ListeningPort(host, 29999, dashboard.serve)
        with suppress(OSError):
            await port.open()
            return port
    raise AssertionError("no free loopback address")


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        file.name: file.read_bytes() for file in folder.iterdir() if file.is_file() and file.suffix != ".pdf"
    }


def login_for(sftp: WritableSftp, **changes: object) -> StoreLogin:
    settings = {"password": PASSWORD, "host_keys": (sftp.fingerprint,), "timeout_s": DEADLINE_S}
    return StoreLogin(**{**settings, **changes})  # type: ignore[arg-type]


def address_of(found: SimpleNamespace) -> str:
    return f"ur://{found.host}:{found.sftp.port}"


async def test_all_programs_are_fetched_and_nothing_else(controller: SimpleNamespace, tmp_path: Path) -> None:
    async with store_at(address_of(controller), login_for(controller.sftp))() as store:
        assert await fetch_programs(store, tmp_path / "out") == OLD
        assert await store.read_file("nothing.urp") is None
        assert await folders_below(store) == ("sub.script",)


async def test_programs_are_delivered_and_put_back(controller: SimpleNamespace, tmp_path: Path) -> None:
    open_store = store_at(address_of(controller), login_for(controller.sftp))
    stored = await deliver_programs(open_store, NEW, tmp_path / "copies", EVA, address_of(controller))
    assert files_of(controller.folder) == NEW
    assert (controller.folder / "weld.urp").stat().st_mode & 0o777 == 0o750
    await restore_programs(open_store, read_delivery(stored.folder), EVA)
    assert files_of(controller.folder) == OLD


@pytest.mark.parametrize("state", ["PLAYING weld.urp", "PAUSED weld.urp"])
async def test_nothing_is_written_while_a_program_is_active(
    controller: SimpleNamespace, tmp_path: Path, state: str
) -> None:
    controller.dashboard.state = state
    open_store = store_at(address_of(controller), login_for(controller.sftp))
    with pytest.raises(RefusedError, match="a program runs on the controller, or is paused"):
        await deliver_programs(open_store, NEW, tmp_path / "copies", STANDS, address_of(controller))
    assert files_of(controller.folder) == OLD


async def test_without_a_dashboard_a_person_says_that_the_robot_stands(
    controller: SimpleNamespace, tmp_path: Path
) -> None:
    await controller.server.wait_closed()
    open_store = store_at(address_of(controller), login_for(controller.sftp))
    with pytest.raises(DeliveryRefusedError, match="nothing here tells whether a program runs"):
        await deliver_programs(open_store, NEW, tmp_path / "copies", EVA, address_of(controller))
    assert files_of(controller.folder) == OLD
    await deliver_programs(open_store, NEW, tmp_path / "copies", STANDS, address_of(controller))
    assert files_of(controller.folder) == NEW


async def test_an_answer_that_is_no_state_is_no_permission(
    controller: SimpleNamespace, tmp_path: Path
) -> None:
    controller.dashboard.state = "could not understand: programState"
    open_store = store_at(address_of(controller), login_for(controller.sftp))
    with pytest.raises(WireProtocolError, match="does not say whether a program runs"):
        await deliver_programs(open_store, NEW, tmp_path / "copies", STANDS, address_of(controller))
    assert files_of(controller.folder) == OLD


@pytest.mark.parametrize("pinned", [(), ("SHA256:" + "A" * 43,)])
async def test_an_unknown_key_is_refused_before_the_password_is_sent(
    controller: SimpleNamespace, pinned: tuple[str, ...]
) -> None:
    login = login_for(controller.sftp, host_keys=pinned)
    with pytest.raises(RefusedError, match=re.escape(controller.sftp.fingerprint)) as caught:
        async with store_at(address_of(controller), login)():
            pass
    assert ("--host-key" in str(caught.value.remedy)) == (not pinned)
    assert controller.sftp.passwords == []


async def test_a_wrong_password_is_said(controller: SimpleNamespace) -> None:
    with pytest.raises(RefusedError, match="does not accept user and password"):
        async with store_at(address_of(controller), login_for(controller.sftp, password="wrong"))():
            pass


async def test_a_controller_that_refuses_writing_is_left_as_it_is(
    controller: SimpleNamespace, tmp_path: Path
) -> None:
    controller.sftp.refuses_writing = True
    open_store = store_at(address_of(controller), login_for(controller.sftp))
    with pytest.raises(DeliveryFailedError, match="the disk is read-only"):
        await deliver_programs(open_store, NEW, tmp_path / "copies", EVA, address_of(controller))
    assert files_of(controller.folder) == OLD


async def test_a_file_that_arrives_changed_never_takes_its_place(
    controller: SimpleNamespace, tmp_path: Path
) -> None:
    controller.sftp.spoils = True
    open_store = store_at(address_of(controller), login_for(controller.sftp))
    with pytest.raises(DeliveryFailedError, match="did not arrive as it was sent"):
        await deliver_programs(open_store, NEW, tmp_path / "copies", EVA, address_of(controller))
    assert files_of(controller.folder) == OLD


async def test_a_folder_that_is_not_there_is_said(controller: SimpleNamespace) -> None:
    async with store_at(f"{address_of(controller)}/elsewhere", login_for(controller.sftp))() as store:
        with pytest.raises(RefusedError, match="no such file or folder"):
            await store.list_names()


async def test_a_port_that_speaks_no_ssh_or_none_at_all_is_said(controller: SimpleNamespace) -> None:
    login = login_for(controller.sftp)
    with pytest.raises(DeviceError, match=r"SSH could not be started|the connection was lost"):
        async with store_at(f"ur://{controller.host}:29999", login)():
            pass
    with pytest.raises(UnreachableError, match="no connection to"):
        async with store_at(f"ur://{controller.host}:1", login)():
            pass


@pytest.mark.parametrize(
    "cut_after", [0, 40, 1500, 2500, 3200, 4000, 6000, 20_000, 300_000, 600_000, 1_000_000]
)
async def test_a_cut_at_any_moment_leaves_all_old_or_all_new(
    controller: SimpleNamespace, tmp_path: Path, cut_after: int
) -> None:
    async with CuttingProxy(controller.host, controller.sftp.port, cut_after) as proxy:
        address = f"ur://127.0.0.1:{proxy.port}"
        stored: StoredDelivery | None
        try:
            open_store = store_at(address, login_for(controller.sftp))
            stored = await deliver_programs(open_store, NEW, tmp_path / "copies", STANDS, address)
        except DeliveryFailedError as error:
            stored = error.stored
        except DeviceError:
            stored = None
    state = None if stored is None else read_delivery(stored.folder).delivery.state
    assert proxy.was_cut or state is DeliveryState.DELIVERED
    assert state in (None, DeliveryState.PUT_BACK, DeliveryState.DELIVERED)
    found = {
        name: content for name, content in files_of(controller.folder).items() if not name.startswith(".")
    }
    assert found == (NEW if state is DeliveryState.DELIVERED else OLD)
