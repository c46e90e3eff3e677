"""Two deliveries to one controller at once: neither takes the other's half for what was there before."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from cellcal.drivers.wire.folder_store import FolderStore
from cellcal.service.engineering.delivery.deliveries import (
    Approval,
    DeliveryFailedError,
    DeliveryRefusedError,
    deliver_programs,
    hold_controller,
)
from cellcal.service.engineering.delivery.store_addresses import StoreLogin, host_of, store_at

STANDS = Approval("Eva", robot_stands=True)


class DisturbedStore(FolderStore):
    """A folder in which another computer writes a program after the first reading of all."""

    def __init__(self, folder: Path, others: dict[str, bytes]) -> None:
        super().__init__(folder)
        self._place, self._others = folder, others

    async def write_file(self, name: str, content: bytes) -> None:
        await super().write_file(name, content)
        for other, text in self._others.items():
            (self._place / other).write_bytes(text)
        self._others = {}


async def test_a_second_delivery_waits_for_the_first(tmp_path: Path) -> None:
    share, copies = tmp_path / "share", tmp_path / "copies"
    share.mkdir()
    (share / "A.SRC").write_bytes(b"OLD")
    with hold_controller(copies, str(share)), pytest.raises(DeliveryRefusedError, match="goes on now"):
        await deliver_programs(
            store_at(str(share), StoreLogin()), {"A.SRC": b"NEW"}, copies, STANDS, str(share)
        )
    assert (share / "A.SRC").read_bytes() == b"OLD"
    await deliver_programs(store_at(str(share), StoreLogin()), {"A.SRC": b"NEW"}, copies, STANDS, str(share))
    assert (share / "A.SRC").read_bytes() == b"NEW"


async def test_what_another_computer_wrote_meanwhile_is_left(tmp_path: Path) -> None:
    share = tmp_path / "share"
    share.mkdir()
    (share / "A.SRC").write_bytes(b"OLD A")
    (share / "B.SRC").write_bytes(b"OLD B")
    store = DisturbedStore(share, {"B.SRC": b"OF ANOTHER"})

    @asynccontextmanager
    async def open_store() -> AsyncIterator[FolderStore]:
        yield store

    new = {"A.SRC": b"NEW A", "B.SRC": b"NEW B"}
    with pytest.raises(DeliveryFailedError, match=r"B\.SRC was changed on the controller") as failed:
        await deliver_programs(open_store, new, tmp_path / "copies", STANDS, str(share))
    assert failed.value.stored.delivery.state == "put_back"
    assert (share / "A.SRC").read_bytes() == b"OLD A"
    assert (share / "B.SRC").read_bytes() == b"OF ANOTHER"


def test_folders_of_one_controller_are_held_together() -> None:
    assert host_of("ur://Cell-3/programs") == host_of("ur://cell-3/other")
    assert host_of("ur://cell-3") != host_of("abb://cell-3")
