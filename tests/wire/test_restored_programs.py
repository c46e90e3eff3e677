"""Programs that were changed after a delivery are copied before they are replaced, and only on request."""

from pathlib import Path

import pytest

from cellcal.service.engineering.delivery.deliveries import (
    Approval,
    DeliveryRefusedError,
    deliver_programs,
    restore_programs,
)
from cellcal.service.engineering.delivery.store_addresses import OpenStore, StoreLogin, store_at
from cellcal.service.engineering.delivery.stored_copies import (
    DeliveryState,
    StoredDelivery,
    read_delivery,
)

EVA = Approval("Eva", robot_stands=True)
OLD = {"a.src": b"OLD"}
NEW = {"a.src": b"NEW", "b.src": b"ADDED"}
CHANGED = {"a.src": b"NEW, touched up at the pendant", "b.src": b"ADDED, then reworked for a week"}


class Share:
    """A folder as a controller, with a delivery."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "share"
        self.folder.mkdir()
        self.write(OLD)

    @property
    def open_store(self) -> OpenStore:
        return store_at(str(self.folder), StoreLogin())

    def write(self, files: dict[str, bytes]) -> None:
        for name, content in files.items():
            (self.folder / name).write_bytes(content)

    def files(self) -> dict[str, bytes]:
        return {entry.name: entry.read_bytes() for entry in self.folder.iterdir()}


@pytest.fixture
def share(tmp_path: Path) -> Share:
    return Share(tmp_path)


@pytest.fixture
async def delivered(share: Share, tmp_path: Path) -> StoredDelivery:
    return await deliver_programs(share.open_store, NEW, tmp_path / "copies", EVA, str(share.folder))


async def test_what_was_changed_since_the_delivery_is_not_replaced(
    share: Share, delivered: StoredDelivery
) -> None:
    share.write(CHANGED)
    with pytest.raises(DeliveryRefusedError, match=r"a\.src, b\.src: changed"):
        await restore_programs(share.open_store, delivered, EVA)
    assert share.files() == CHANGED
    assert read_delivery(delivered.folder).delivery.state is DeliveryState.DELIVERED


async def test_what_was_deleted_since_the_delivery_counts_as_changed(
    share: Share, delivered: StoredDelivery
) -> None:
    (share.folder / "a.src").unlink()
    with pytest.raises(DeliveryRefusedError, match=r"a\.src: changed"):
        await restore_programs(share.open_store, delivered, EVA)
    assert share.files() == {"b.src": b"ADDED"}


async def test_what_was_changed_is_copied_before_it_is_replaced_and_comes_back(
    share: Share, delivered: StoredDelivery
) -> None:
    share.write(CHANGED)
    restored = await restore_programs(share.open_store, delivered, EVA, changed_too=True)
    assert restored.put_back.delivery.state is DeliveryState.PUT_BACK
    assert share.files() == OLD
    assert restored.replaced is not None
    copies = read_delivery(restored.replaced.folder)
    assert copies.delivery.state is DeliveryState.DELIVERED
    assert {file.name: copies.old_content(file) for file in copies.delivery.files} == CHANGED
    await restore_programs(share.open_store, copies, EVA)
    assert share.files() == CHANGED


async def test_a_delivery_that_was_put_back_replaces_nothing_of_a_later_one(
    share: Share, delivered: StoredDelivery, tmp_path: Path
) -> None:
    await restore_programs(share.open_store, delivered, EVA)
    again = await restore_programs(share.open_store, read_delivery(delivered.folder), EVA)
    assert again.replaced is None
    assert share.files() == OLD
    await deliver_programs(share.open_store, NEW, tmp_path / "copies", EVA, str(share.folder))
    with pytest.raises(DeliveryRefusedError, match="after it was put back"):
        await restore_programs(share.open_store, read_delivery(delivered.folder), EVA)
    assert share.files() == NEW
