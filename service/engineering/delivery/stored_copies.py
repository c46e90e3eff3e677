"""Copies of programs before a delivery: a folder each, with a signed document that holds their checksums.

A delivery begins when its copies are on the disk and were read back. The document says what was approved, by whom,
and how far the delivery came; it is written anew at each of these points.
"""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.draft_files import remove_drafts_once
from cellcal.service.files import SHARED_FILE, make_private_folder, replace_file
from cellcal.service.record.signing import (
    CheckedDocument,
    CheckFinding,
    check_document,
    read_document,
    station_key,
)

FORMAT = "cellcal program delivery"
DOCUMENT = "delivery.json"
_OLD = "old"
_NEW = "new"


class DeliveryState(StrEnum):
    """The progress of a delivery."""

    BEGUN = "begun"  # and never ended: a crash, or the controller was lost
    DELIVERED = "delivered"
    PUT_BACK = "put_back"  # what was there before is there again
    UNKNOWN = "unknown"  # neither could be read back


class DeliveredFile(BaseModel):
    """One program: checksums of what was there and of what was sent; None: there was none, or it was deleted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    old_sha256: str | None
    new_sha256: str | None


class Delivery(BaseModel):
    """The contents of the signed document."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    address: str
    approved_by: str
    begun_utc: str
    state: DeliveryState
    files: tuple[DeliveredFile, ...]


class DeliveryError(CellError):
    """Copies cannot be kept, or are not what they were."""

    code = "store"


@dataclass(frozen=True, slots=True)
class StoredDelivery:
    """A delivery and the folder that holds it."""

    folder: Path
    delivery: Delivery

    def old_content(self, file: DeliveredFile) -> bytes | None:
        """Return the copy of what was there before; None where nothing was.

        Raises
        ------
        DeliveryError
            The copy is not what was stored.
        """
        if file.old_sha256 is None:
            return None
        return _read_copy(self.folder / _OLD / file.name, file.old_sha256)

    def new_content(self, file: DeliveredFile) -> bytes | None:
        """Return the copy of what was sent; None where the program was deleted; errors as for `old_content`."""
        if file.new_sha256 is None:
            return None
        return _read_copy(self.folder / _NEW / file.name, file.new_sha256)

    def with_state(self, state: DeliveryState) -> "StoredDelivery":
        """Write the document with another state."""
        changed = self.delivery.model_copy(update={"state": state})
        _write_document(self.folder, changed)
        return StoredDelivery(self.folder, changed)


def sha256_of(content: bytes) -> str:
    """Return the checksum of a program."""
    return hashlib.sha256(content).hexdigest()


def store_copies(
    copies: Path,
    address: str,
    approved_by: str,
    old: Mapping[str, bytes | None],
    new: Mapping[str, bytes | None],
) -> StoredDelivery:
    """Keep what is there and what will be sent (None: will be deleted), and read both back.

    Raises
    ------
    DeliveryError
        They cannot be kept.
    """
    begun_utc = datetime.now(UTC).isoformat()
    stamp = begun_utc[:26].translate(str.maketrans("", "", "-:.+"))
    plain = "".join(c if c.isalnum() else "-" for c in address)[-48:].strip("-")
    folder = copies / f"{stamp}_{plain}"
    files = []
    try:
        make_private_folder(copies)
        remove_drafts_once(copies)
        for part in (_OLD, _NEW):
            make_private_folder(folder / part)
        for name, content in new.items():
            before = old[name]
            if before is not None:
                replace_file(folder / _OLD / name, before)
            if content is not None:
                replace_file(folder / _NEW / name, content)
            old_sha256 = None if before is None else sha256_of(before)
            new_sha256 = None if content is None else sha256_of(content)
            files.append(DeliveredFile(name=name, old_sha256=old_sha256, new_sha256=new_sha256))
    except OSError as error:
        raise _unwritable(copies, error) from error
    delivery = Delivery(
        address=address,
        approved_by=approved_by,
        begun_utc=begun_utc,
        state=DeliveryState.BEGUN,
        files=tuple(files),
    )
    stored = StoredDelivery(folder, delivery)
    for file in files:
        stored.old_content(file)
        stored.new_content(file)
    _write_document(folder, delivery)
    return stored


def read_delivery(folder: Path) -> StoredDelivery:
    """Read a delivery back.

    Raises
    ------
    DeliveryError
        It was changed since it was signed, another key signed it, or it is none.
    """
    try:
        key = station_key(folder.parent).public_key if (folder / DOCUMENT).exists() else None
    except OSError as error:
        raise _unreadable(folder, error.strerror or str(error)) from error
    raw = read_document(folder / DOCUMENT)
    checked = raw if isinstance(raw, CheckedDocument) else check_document(raw, expected_key=key)
    if checked.finding is not CheckFinding.INTACT:
        raise _unreadable(folder, checked.sentence)
    try:
        return StoredDelivery(folder, Delivery.model_validate_json(json.dumps(checked.content)))
    except ValidationError as error:
        raise _unreadable(folder, "it is no delivery") from error


def list_unended(copies: Path, address: str) -> tuple[StoredDelivery, ...]:
    """Return the deliveries to an address that began and never ended, oldest first, as far as they can be read."""
    found = []
    try:
        folders = sorted(each.parent for each in copies.glob(f"*/{DOCUMENT}"))
    except OSError:
        return ()
    for folder in folders:
        with suppress(CellError):
            stored = read_delivery(folder)
            if stored.delivery.state is DeliveryState.BEGUN and stored.delivery.address == address:
                found.append(stored)
    return tuple(found)


def _write_document(folder: Path, delivery: Delivery) -> None:
    try:
        key = station_key(folder.parent)
        text = key.sign_document(FORMAT, delivery.model_dump(mode="json"))
        replace_file(folder / DOCUMENT, text, mode=SHARED_FILE)
    except OSError as error:
        raise _unwritable(folder, error) from error


def _read_copy(path: Path, sha256: str) -> bytes:
    try:
        content = read_plain_bytes(path)
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from error
    except DocumentError as error:
        raise _unreadable(path, error.message) from error
    if sha256_of(content) != sha256:
        raise _unreadable(path, "its checksum is another")
    return content


def _unwritable(folder: Path, error: OSError) -> DeliveryError:
    return DeliveryError(
        make_message(
            "copies cannot be kept in {folder}: {reason}.",
            folder=folder,
            reason=error.strerror or str(error),
        ),
        remedy="Give another folder with --copies. Nothing was delivered.",
    )


def _unreadable(path: Path, reason: str) -> DeliveryError:
    return DeliveryError(
        make_message("{path} is not used: {reason}.", path=path, reason=reason.rstrip(".")),
        remedy="Restore the folder from a backup, or write the programs at the controller.",
        code="signature",
    )
