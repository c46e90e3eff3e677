"""Names of programs on controllers: in any case of letters, with the makers' own signs, and never out of a folder."""

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.calibration.errors import CellError
from cellcal.drivers.abb.robot_web_services.dialects import Dialect, FirstDialect, SecondDialect
from cellcal.drivers.abb.robot_web_services.program_store import AbbProgramStore
from cellcal.drivers.errors import RefusedError, WireProtocolError
from cellcal.service.engineering.delivery.comparison import fetch_programs
from cellcal.service.engineering.delivery.deliveries import Approval, deliver_programs, restore_programs
from cellcal.service.engineering.delivery.store_addresses import StoreLogin, store_at
from cellcal.service.engineering.delivery.stored_copies import (
    DeliveryState,
    list_unended,
    read_delivery,
    store_copies,
)
from tests.wire.writable_ftp import PASSWORD, USER, writable_ftp

STANDS = Approval("Eva", robot_stands=True)
LOGIN = StoreLogin(timeout_s=5.0)
LISTING = b"/PROG  WELD\r\n/ATTR\r\n/MN\r\n   1:  R[1]=%d    ;\r\n/POS\r\n/END\r\n"


async def test_a_program_is_replaced_whatever_the_case_of_its_name(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    (share / "A.SRC").write_bytes(b"OLD")
    open_store = store_at(str(share), LOGIN)
    stored = await deliver_programs(open_store, {"a.src": b"NEW"}, tmp_path / "copies", STANDS, "share")
    assert stored.old_content(stored.delivery.files[0]) == b"OLD"
    assert {entry.name: entry.read_bytes() for entry in share.iterdir()} == {"A.SRC": b"NEW"}
    await restore_programs(open_store, stored, STANDS)
    assert {entry.name: entry.read_bytes() for entry in share.iterdir()} == {"A.SRC": b"OLD"}


@pytest.mark.parametrize("left", [b"NEW pro", b"", None])
async def test_what_a_killed_delivery_left_is_put_back_by_one_command(
    tmp_path: Path, left: bytes | None
) -> None:
    share, copies = tmp_path / "share", tmp_path / "copies"
    share.mkdir()
    (share / "A.SRC").write_bytes(b"OLD")
    (share / "B.SRC").write_bytes(b"OLD B")
    open_store = store_at(str(share), LOGIN)
    new: dict[str, bytes | None] = {"A.SRC": b"NEW program", "B.SRC": b"NEW B"}
    stored = store_copies(
        copies, "share", "Eva", {"A.SRC": b"OLD", "B.SRC": b"OLD B"}, new
    )  # and killed here
    (share / "A.SRC").unlink() if left is None else (share / "A.SRC").write_bytes(left)
    assert [each.folder for each in list_unended(copies, "share")] == [stored.folder]
    assert list_unended(copies, "elsewhere") == ()
    await restore_programs(open_store, read_delivery(stored.folder), STANDS)
    assert {entry.name: entry.read_bytes() for entry in share.iterdir()} == {
        "A.SRC": b"OLD",
        "B.SRC": b"OLD B",
    }
    assert list_unended(copies, "share") == ()


async def test_what_a_person_wrote_after_a_killed_delivery_is_not_replaced(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    stored = store_copies(tmp_path / "copies", "share", "Eva", {"A.SRC": b"OLD"}, {"A.SRC": b"NEW program"})
    (share / "A.SRC").write_bytes(b"NEW by hand")
    with pytest.raises(CellError, match=r"A\.SRC: changed on the controller"):
        await restore_programs(store_at(str(share), LOGIN), stored, STANDS)


async def test_where_the_copies_are_is_said_before_the_first_write(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    (share / "A.SRC").write_bytes(b"OLD")
    old_draft = share / ".cellcalabcd_012"  # of a delivery that was killed long ago
    old_draft.write_bytes(b"NE")
    os.utime(old_draft, (0, 0))
    seen: list[tuple[bytes, bytes | None]] = []
    stored = await deliver_programs(
        store_at(str(share), LOGIN), {"A.SRC": b"NEW"}, tmp_path / "copies", STANDS, "share",
        on_copies=lambda copied: seen.append(
            ((share / "A.SRC").read_bytes(), copied.old_content(copied.delivery.files[0]))
        ),
    )  # fmt: skip
    assert seen == [(b"OLD", b"OLD")]
    assert stored.delivery.state is DeliveryState.DELIVERED
    assert [entry.name for entry in share.iterdir()] == ["A.SRC"]


async def test_two_names_that_differ_in_case_only_are_refused(tmp_path: Path) -> None:
    share, old = tmp_path / "share", {"A.SRC": b"OLD", "a.src": b"OLDER"}
    share.mkdir()
    for name, content in old.items():
        (share / name).write_bytes(content)
    with pytest.raises(RefusedError, match=r"A\.SRC and a\.src are one program"):
        await deliver_programs(
            store_at(str(share), LOGIN), {"a.src": b"NEW"}, tmp_path / "copies", STANDS, "share"
        )
    assert {entry.name: entry.read_bytes() for entry in share.iterdir()} == old
    assert not (tmp_path / "copies").exists()


async def test_a_listing_is_replaced_whatever_the_case_of_its_name(tmp_path: Path) -> None:
    folder = tmp_path / "md"
    folder.mkdir()
    (folder / "weld.ls").write_bytes(LISTING % 1)
    with writable_ftp(folder) as server:
        open_store = store_at(f"fanuc://127.0.0.1:{server.port}", StoreLogin(USER, PASSWORD, timeout_s=5.0))
        stored = await deliver_programs(
            open_store, {"WELD.LS": LISTING % 2}, tmp_path / "copies", STANDS, "fanuc"
        )
        assert [entry.name for entry in folder.iterdir()] == ["weld.ls"]
        assert b"R[1]=2" in (folder / "weld.ls").read_bytes()
        await restore_programs(open_store, stored, STANDS)
    assert b"R[1]=1" in (folder / "weld.ls").read_bytes()


async def test_a_folder_without_programs_names_those_below_that_hold_some(tmp_path: Path) -> None:
    share = tmp_path / "share"
    (share / "R1" / "Program").mkdir(parents=True)
    (share / "empty").mkdir()
    async with store_at(str(share), LOGIN)() as store:
        with pytest.raises(CellError, match="holds no program") as empty:
            await fetch_programs(store, tmp_path / "out")
        assert "Name the folder" in str(empty.value.remedy)
        (share / "R1" / "Program" / "main.src").write_bytes(b"DEF main()\nEND\n")
        with pytest.raises(CellError, match="holds no program") as caught:
            await fetch_programs(store, tmp_path / "out")
    assert "below it: R1/Program." in str(caught.value.remedy)
    assert not (tmp_path / "out").exists()


async def test_names_that_a_controller_gives_its_own_files_are_fetched_and_delivered(tmp_path: Path) -> None:
    share, old = (
        tmp_path / "share",
        {"$config.dat": b"DEFDAT $CONFIG\nENDDAT\n", "höhe (2).src": b"x", "log": b""},
    )
    share.mkdir()
    for name, content in old.items():
        (share / name).write_bytes(content)
    open_store, new = store_at(str(share), LOGIN), {"$config.dat": b"DEFDAT $CONFIG\n; moved\nENDDAT\n"}
    async with open_store() as store:
        assert await fetch_programs(store, tmp_path / "out") == old
    await deliver_programs(open_store, new, tmp_path / "copies", STANDS, "share")
    assert (share / "$config.dat").read_bytes() == new["$config.dat"]


class NamedFiles:
    """A controller that lists these names."""

    device = "r2"

    def __init__(self, *names: str) -> None:
        self._names = names

    async def list_names(self) -> tuple[str, ...]:
        return self._names

    async def read_file(self, name: str) -> bytes | None:
        return name.encode()


@pytest.mark.parametrize(
    "names",
    [
        ("../x.mod",), ("a\\b.mod",), ("c:x.mod",), ("..",), ("a\nb.mod",), ("a.mod", "A.MOD"), ("\ud800.mod",),
        ("a" * 300,),
    ],
)  # fmt: skip
async def test_no_name_of_a_controller_leads_out_of_the_folder_of_its_copies(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    """Such a name is left and named with its controller; the other programs are copied."""
    store: Any = NamedFiles("weld.mod", *names)
    with pytest.raises(
        CellError, match=r"r2: \d of \d programs cannot be read and were not copied"
    ) as caught:
        await fetch_programs(store, tmp_path / "out")
    assert repr(names[0][:80]) in caught.value.message
    assert {entry.name for entry in (tmp_path / "out").iterdir()} == {"weld.mod"}


@pytest.mark.parametrize("dialect", [FirstDialect(), SecondDialect()])
async def test_an_unknown_answer_is_no_empty_list_of_files(dialect: Dialect) -> None:
    async def get_document(_path: str, **_query: str) -> dict[str, object]:
        return {"_embedded": {"files": []}}

    link: Any = SimpleNamespace(device="abb", dialect=dialect, get_document=get_document)
    with pytest.raises(WireProtocolError, match="is not understood"):
        await AbbProgramStore(link, "$HOME").list_names()
