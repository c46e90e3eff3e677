"""Programs of controllers over the wire: copied, compared, delivered, put back, and never half there."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from yrcom import HsesFileClient

from cellcal.calibration.errors import CellError
from cellcal.drivers.errors import DeviceError, RefusedError
from cellcal.drivers.fanuc.controller_files.controller_address import ControllerAddress
from cellcal.drivers.fanuc.controller_files.ftp_source import FtpLogin, FtpSource
from cellcal.drivers.fanuc.controller_files.program_digests import read_program_digests
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell_client import FakeCellClient
from cellcal.service.engineering.delivery.comparison import (
    Difference,
    compare_programs,
    fetch_programs,
    read_programs,
)
from cellcal.service.engineering.delivery.deliveries import (
    Approval,
    DeliveryFailedError,
    DeliveryRefusedError,
    deliver_programs,
    restore_programs,
)
from cellcal.service.engineering.delivery.store_addresses import OpenStore, StoreLogin, store_at
from cellcal.service.engineering.delivery.stored_copies import (
    DeliveryError,
    DeliveryState,
    StoredDelivery,
    read_delivery,
)
from tests.wire.cutting_proxy import CuttingProxy
from tests.wire.robot_cases import ROBOTS
from tests.wire.writable_ftp import PASSWORD, READ, USER, writable_ftp

EVA, STANDS = Approval("Eva"), Approval("Eva", robot_stands=True)
LOGIN = StoreLogin(timeout_s=5.0)
OLD = {"main.mod": b"MODULE main\nENDMODULE\n", "other.mod": b"MODULE other\nENDMODULE\n"}
NEW = {
    "main.mod": b"MODULE main\n! moved\nENDMODULE\n" + b"! " * 500 + b"\n",
    "other.mod": b"MODULE other\n! moved\nENDMODULE\n",
    "added.mod": b"MODULE added\nENDMODULE\n",
}
LISTING = b"/PROG  WELD\r\n/ATTR\r\nMODIFIED\t= DATE 26-01-01  TIME 10:00:00;\r\n/MN\r\n   1:  R[1]=%d    ;\r\n/POS\r\n/END\r\n"


class AbbFiles:
    """One ABB of the cell, stopped, with the old programs."""

    def __init__(self, client: FakeCellClient, name: str, config: Any) -> None:
        self._client, self.name = client, name
        self.host, self.port = config.address, config.port

    @property
    def address(self) -> str:
        return f"abb://{self.host}:{self.port}"

    async def prepare(self) -> None:
        await self._client.inject_fault("mend", device=self.name)
        await self._client.inject_fault("files_deleted", device=self.name)
        await self._client.inject_fault("program_stop", device=self.name)
        async with store_at(self.address, LOGIN)() as store:
            for name, content in OLD.items():
                await store.write_file(name, content)

    async def files(self) -> dict[str, bytes]:
        truth = (await self._client.read_truth())["robots"][self.name]
        return {name: bytes.fromhex(content) for name, content in truth["files"].items()}


@pytest.fixture(params=["abb", "abb_7"])
async def abb(request: pytest.FixtureRequest, cell: CellConfig, fake_client: FakeCellClient) -> AbbFiles:
    found = AbbFiles(fake_client, request.param, cell.robot_named(request.param))
    await found.prepare()
    return found


async def test_programs_are_delivered_and_put_back_by_one_call(abb: AbbFiles, tmp_path: Path) -> None:
    open_store = store_at(abb.address, LOGIN)
    stored = await deliver_programs(open_store, NEW, tmp_path, EVA, abb.address)
    assert stored.delivery.state is DeliveryState.DELIVERED
    assert await abb.files() == NEW  # and no draft is left
    read = read_delivery(stored.folder)
    assert read.delivery.approved_by == "Eva"
    assert {file.name: read.old_content(file) for file in read.delivery.files} == {**OLD, "added.mod": None}
    assert (await restore_programs(open_store, read, EVA)).put_back.delivery.state is DeliveryState.PUT_BACK
    assert await abb.files() == OLD


async def test_nothing_is_written_while_a_program_runs(
    abb: AbbFiles, tmp_path: Path, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("program_start", device=abb.name)
    with pytest.raises(RefusedError, match="a program runs"):
        await deliver_programs(store_at(abb.address, LOGIN), NEW, tmp_path / "copies", EVA, abb.address)
    assert await abb.files() == OLD
    assert not (tmp_path / "copies").exists()


async def test_an_upload_that_breaks_leaves_the_old_programs(
    abb: AbbFiles, tmp_path: Path, fake_client: FakeCellClient
) -> None:
    await fake_client.inject_fault("cut_upload", device=abb.name, count=1)
    with pytest.raises(DeliveryFailedError, match="is there again") as caught:
        await deliver_programs(store_at(abb.address, LOGIN), NEW, tmp_path, EVA, abb.address)
    assert caught.value.stored.delivery.state is DeliveryState.PUT_BACK
    assert await abb.files() == OLD


@pytest.mark.parametrize(
    "cut_after", [0, 300, 900, 1500, 2500, 4000, 5500, 7000, 9000, 11_000, 13_000, 16_000]
)
async def test_a_cut_at_any_moment_leaves_all_old_or_all_new(
    abb: AbbFiles, tmp_path: Path, cut_after: int
) -> None:
    async with CuttingProxy(abb.host, abb.port, cut_after) as proxy:
        address = f"abb://127.0.0.1:{proxy.port}"
        stored: StoredDelivery | None
        try:
            stored = await deliver_programs(store_at(address, LOGIN), NEW, tmp_path, EVA, address)
        except DeliveryFailedError as error:
            stored = error.stored
        except DeviceError:
            stored = None
    state = None if stored is None else read_delivery(stored.folder).delivery.state
    assert proxy.was_cut or state is DeliveryState.DELIVERED
    assert state in (None, DeliveryState.PUT_BACK, DeliveryState.DELIVERED)
    expected = NEW if state is DeliveryState.DELIVERED else OLD
    found = await abb.files()
    assert {name: text for name, text in found.items() if not name.startswith("cellcal_draft_")} == expected


async def test_a_controller_that_does_not_come_back_is_said_and_restored_later(
    abb: AbbFiles, tmp_path: Path, fake_client: FakeCellClient
) -> None:
    open_store = store_at(abb.address, StoreLogin(timeout_s=2.0))
    await fake_client.inject_fault("cut_upload", device=abb.name, count=1)

    class Gone:
        """The second connection finds nothing."""

        uses = 0

    def open_once() -> Any:
        Gone.uses += 1
        return open_store() if Gone.uses == 1 else store_at("abb://127.0.0.1:1", StoreLogin(timeout_s=0.5))()

    with pytest.raises(DeliveryFailedError, match="could not be put back") as caught:
        await deliver_programs(open_once, NEW, tmp_path, EVA, abb.address)
    assert Gone.uses > 2
    assert caught.value.stored.delivery.state is DeliveryState.UNKNOWN
    stored = read_delivery(caught.value.stored.folder)
    await restore_programs(open_store, stored, EVA)
    assert await abb.files() == OLD


async def test_names_with_signs_of_an_address_are_copied(abb: AbbFiles, tmp_path: Path) -> None:
    names = ("PICK #2.mod", "50%41.mod", "what?.mod", "a&b+c.mod")
    async with store_at(abb.address, LOGIN)() as store:
        for name in names:
            await store.write_file(name, name.encode())
        fetched = await fetch_programs(store, tmp_path / "out")
        assert {name: fetched[name] for name in names} == {name: name.encode() for name in names}
        for name in names:
            await store.delete_file(name)
        assert not set(names) & set(await store.list_names())


async def test_all_programs_are_fetched_and_compared(abb: AbbFiles, tmp_path: Path) -> None:
    async with store_at(abb.address, LOGIN)() as store:
        for number in range(12):  # more than a page of the list
            await store.write_file(f"m{number}.mod", b"MODULE m\nENDMODULE\n")
        fetched = await fetch_programs(store, tmp_path / "out")
        assert fetched == await abb.files()
        assert read_programs((tmp_path / "out",)) == fetched
        found = await compare_programs(
            store, {"MAIN.mod": OLD["main.mod"], "other.mod": b"x", "mine.mod": b"y"}
        )
    by_name = {each.name: each.difference for each in found}
    assert by_name["MAIN.mod"] is Difference.SAME
    assert by_name["other.mod"] is Difference.DIFFERS
    assert by_name["mine.mod"] is Difference.ONLY_HERE
    assert by_name["m7.mod"] is Difference.ONLY_THERE


@pytest.mark.parametrize("what", ["copy", "document", "key"])
async def test_copies_that_were_changed_are_not_put_back(abb: AbbFiles, tmp_path: Path, what: str) -> None:
    open_store = store_at(abb.address, LOGIN)
    stored = await deliver_programs(open_store, NEW, tmp_path / "copies", EVA, abb.address)
    if what == "copy":
        (stored.folder / "old" / "main.mod").write_bytes(b"MODULE evil\nENDMODULE\n")
    elif what == "document":
        path = stored.folder / "delivery.json"
        path.write_text(path.read_text().replace("Eva", "Eve"))
    else:
        stored.folder.rename(tmp_path / "moved")
        stored = type(stored)(tmp_path / "moved", stored.delivery)
    with pytest.raises(DeliveryError, match="is not used"):
        await restore_programs(open_store, read_delivery(stored.folder), EVA)
    assert await abb.files() == NEW


# FANUC, by FTP


def fanuc_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "md"
    folder.mkdir()
    (folder / "weld.ls").write_bytes(LISTING % 1)
    (folder / "errall.ls").write_bytes(b"log")
    return folder


def fanuc_store(port: int) -> OpenStore:
    return store_at(f"fanuc://127.0.0.1:{port}", StoreLogin(USER, PASSWORD, timeout_s=5.0))


async def test_a_listing_is_delivered_although_the_controller_translates_it(tmp_path: Path) -> None:
    folder, copies = fanuc_folder(tmp_path), tmp_path / "copies"
    with writable_ftp(folder) as server:
        open_store = fanuc_store(server.port)
        new = {"weld.ls": LISTING % 2, "added.ls": LISTING % 3}
        with pytest.raises(DeliveryRefusedError, match="nothing here tells"):
            await deliver_programs(open_store, new, copies, EVA, "fanuc")
        stored = await deliver_programs(open_store, new, copies, STANDS, "fanuc")
        assert b"R[1]=2" in (folder / "weld.ls").read_bytes()
        assert (folder / "weld.ls").read_bytes() != LISTING % 2  # its head is the controller's
        async with open_store() as store:
            assert await store.list_names() == ("added.ls", "weld.ls")
            compared = await compare_programs(store, new)
        assert {each.difference for each in compared} == {Difference.SAME}
        await restore_programs(open_store, stored, STANDS)
    assert b"R[1]=1" in (folder / "weld.ls").read_bytes()
    assert not (folder / "added.ls").exists()


@pytest.mark.parametrize(
    "line",
    [
        " {name} ",
        "MD:\\{name}",
        "-rwxrwxrwx   1 noone    nogroup      1234 Jan 01 10:59 {name}",
        "-rw-rw-rw- 1 user group 1234 Aug 11  2021 {name}",
        "08-11-21  10:59AM                 1234 {name}",
    ],
)
async def test_names_are_read_of_each_form_of_a_listing(tmp_path: Path, line: str) -> None:
    folder = fanuc_folder(tmp_path)
    with writable_ftp(folder) as server:
        server.line = line
        login = FtpLogin(USER, PASSWORD)
        with FtpSource(ControllerAddress("127.0.0.1", server.port), login) as source:
            assert source.list_names() == ("errall.ls", "weld.ls")
            assert list(read_program_digests(source)) == ["WELD"]
        async with fanuc_store(server.port)() as store:
            assert await fetch_programs(store, tmp_path / "out") == {"weld.ls": LISTING % 1}


async def test_a_program_that_is_listed_and_not_given_is_named(tmp_path: Path) -> None:
    folder = fanuc_folder(tmp_path)
    (folder / "pick.ls").write_bytes(LISTING % 5)
    with writable_ftp(folder) as server:
        server.locked = ("weld.ls",)
        async with fanuc_store(server.port)() as store:
            with pytest.raises(CellError, match=r"1 of 2 programs cannot be read.*: weld\.ls\."):
                await fetch_programs(store, tmp_path / "out")
        assert (tmp_path / "out" / "pick.ls").read_bytes() == LISTING % 5
        with pytest.raises(RefusedError, match=r"weld\.ls is listed and cannot be read"):
            await deliver_programs(
                fanuc_store(server.port), {"weld.ls": LISTING % 2}, tmp_path / "copies", STANDS, "fanuc"
            )
        with FtpSource(ControllerAddress("127.0.0.1", server.port), FtpLogin(USER, PASSWORD)) as source:
            assert read_program_digests(source)["WELD"] == "not read"
    assert (folder / "weld.ls").read_bytes() == LISTING % 1


async def test_a_controller_that_takes_no_listing_keeps_what_it_has(tmp_path: Path) -> None:
    folder = fanuc_folder(tmp_path)
    with (
        writable_ftp(folder, rights=READ) as server,
        pytest.raises(DeliveryFailedError, match="is there again"),
    ):
        await deliver_programs(
            fanuc_store(server.port), {"weld.ls": LISTING % 2}, tmp_path / "copies", STANDS, "fanuc"
        )
    assert (folder / "weld.ls").read_bytes() == LISTING % 1


@pytest.mark.parametrize("cuts", [1, 2])
async def test_an_ftp_upload_that_breaks_is_put_back(tmp_path: Path, cuts: int) -> None:
    folder = fanuc_folder(tmp_path)
    with writable_ftp(folder) as server:
        server.cuts = cuts  # with two, the first attempt to put back breaks, too
        with pytest.raises(DeliveryFailedError, match="is there again"):
            await deliver_programs(
                fanuc_store(server.port), {"weld.ls": LISTING % 2}, tmp_path / "copies", STANDS, "fanuc"
            )
        assert server.cuts == 0
    assert b"R[1]=1" in (folder / "weld.ls").read_bytes()


async def test_a_listing_that_reads_back_as_another_is_put_back(tmp_path: Path) -> None:
    folder = fanuc_folder(tmp_path)
    with writable_ftp(folder) as server:
        server.spoils = True
        with pytest.raises(
            DeliveryFailedError, match=r"could not be put back: .*reads back as something else"
        ):
            await deliver_programs(
                fanuc_store(server.port), {"weld.ls": LISTING % 2}, tmp_path / "copies", STANDS, "fanuc"
            )


async def test_half_a_listing_is_never_sent(tmp_path: Path) -> None:
    folder = fanuc_folder(tmp_path)
    with writable_ftp(folder) as server, pytest.raises(DeliveryFailedError, match="no whole listing"):
        await deliver_programs(
            fanuc_store(server.port), {"weld.ls": LISTING[:60]}, tmp_path / "copies", STANDS, "fanuc"
        )
    assert (folder / "weld.ls").read_bytes() == LISTING % 1


# Yaskawa

JOB = "/JOB\r\n//NAME WELD\r\nNOP\r\n{line}\r\nEND\r\n"


async def test_jobs_are_delivered_and_a_foreign_client_reads_and_writes_them(
    cell: CellConfig, fake_client: FakeCellClient, tmp_path: Path
) -> None:
    config: Any = cell.robot_named("motoman")
    await ROBOTS["yaskawa"].heal(fake_client, SimpleNamespace(stop=_nothing))
    old, new = JOB.format(line="'old").encode(), JOB.format(line="'new " + "x" * 1200).encode()

    def write_foreign() -> None:
        with HsesFileClient(config.address) as files:
            files.write_file("WELD.JBI", old)

    def read_foreign() -> tuple[list[str], bytes]:
        with HsesFileClient(config.address) as files:
            return files.list_files("*.JBI"), files.read_file("WELD.JBI")

    await asyncio.to_thread(write_foreign)
    address = f"yaskawa://{config.address}"
    open_store = store_at(address, LOGIN)
    stored = await deliver_programs(open_store, {"WELD.JBI": new, "ADDED.JBI": new}, tmp_path, EVA, address)
    assert await asyncio.to_thread(read_foreign) == (["ADDED.JBI", "WELD.JBI"], new)
    await restore_programs(open_store, stored, EVA)
    assert await asyncio.to_thread(read_foreign) == (["WELD.JBI"], old)
    await fake_client.inject_fault("teach_mode", device="motoman")
    with pytest.raises(DeliveryFailedError, match="is there again"):
        await deliver_programs(open_store, {"WELD.JBI": new}, tmp_path, EVA, address)
    assert await asyncio.to_thread(read_foreign) == (["WELD.JBI"], old)


async def test_lost_answers_of_a_yaskawa_leave_the_old_job(
    cell: CellConfig, fake_client: FakeCellClient, tmp_path: Path
) -> None:
    config: Any = cell.robot_named("motoman")
    await ROBOTS["yaskawa"].heal(fake_client, SimpleNamespace(stop=_nothing))
    old, new = JOB.format(line="'old").encode(), JOB.format(line="'new " + "x" * 1200).encode()
    address = f"yaskawa://{config.address}"
    open_store = store_at(address, StoreLogin(timeout_s=0.5))
    async with open_store() as store:
        await store.write_file("WELD.JBI", old)
    await fake_client.inject_fault("lossy", device="motoman")
    with pytest.raises(CellError) as caught:
        await deliver_programs(open_store, {"WELD.JBI": new}, tmp_path, EVA, address)
    await fake_client.send_command("clear")
    if isinstance(caught.value, DeliveryFailedError):
        await restore_programs(open_store, read_delivery(caught.value.stored.folder), EVA)
    async with open_store() as store:
        assert await store.read_file("WELD.JBI") == old


async def _nothing() -> None:
    """Stand for the stop of a robot that was not opened."""


# a folder


async def test_a_mounted_share_is_written_in_one_step(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    (share / "main.src").write_bytes(b"DEF main()\nEND\n")
    open_store = store_at(str(share), LOGIN)
    new = {"main.src": b"DEF main()\n; moved\nEND\n"}
    with pytest.raises(DeliveryRefusedError, match="nothing here tells"):
        await deliver_programs(open_store, new, tmp_path / "copies", EVA, "share")
    stored = await deliver_programs(open_store, new, tmp_path / "copies", STANDS, "share")
    assert [entry.name for entry in share.iterdir()] == ["main.src"]
    assert (share / "main.src").read_bytes() == new["main.src"]
    await restore_programs(open_store, stored, STANDS)
    assert (share / "main.src").read_bytes() == b"DEF main()\nEND\n"


@pytest.mark.parametrize("name", ["../x.mod", "a/b.mod", "", "x", "a\nb.mod", "x" * 90 + ".mod", "ä.mod"])
async def test_a_name_that_is_none_reaches_no_controller(tmp_path: Path, name: str) -> None:
    with pytest.raises(CellError, match="no name"):
        await deliver_programs(store_at(str(tmp_path), LOGIN), {name: b"x"}, tmp_path / "copies", STANDS, "x")


@pytest.mark.parametrize("address", ["http://1.2.3.4", "/no/such/folder", "abb://", "fanuc://a b"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(CellError, match="neither"):
        store_at(address, LOGIN)
