"""Bring programs to a controller so that either all are there or what was there before.

Order: read what is there, keep it with checksums, ask whether a program runs, write, read back, compare. Where any of
it fails, what was there before is put back over a new connection and compared.
"""

import asyncio
import hashlib
import logging
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, RefusedError
from cellcal.drivers.interfaces.program_store import ProgramStore
from cellcal.drivers.wire.cancellation import run_to_end
from cellcal.service.engineering.delivery.store_addresses import OpenStore, host_of
from cellcal.service.engineering.delivery.stored_copies import (
    DeliveryState,
    StoredDelivery,
    store_copies,
)
from cellcal.service.record.robot_lock import LeaseHeldError, acquire_lease

_LOG = logging.getLogger(__name__)
_NAME = re.compile(r"[A-Za-z0-9_$][A-Za-z0-9_ $-]{0,63}\.[A-Za-z0-9]{1,8}")
_ATTEMPTS = 3
_PAUSE_S = 0.5


class DeliveryRefusedError(CellError):
    """A delivery was not begun."""

    code = "delivery"


class DeliveryFailedError(CellError):
    """A delivery did not succeed; ``stored`` says what is on the controller now."""

    code = "delivery.failed"

    def __init__(self, message: str, stored: StoredDelivery, *, remedy: str) -> None:
        super().__init__(message, remedy=remedy)
        self.stored = stored


@dataclass(frozen=True, slots=True)
class Approval:
    """The person who approved, and whether one saw that no program runs."""

    approved_by: str
    robot_stands: bool = False


def check_names(names: Sequence[str]) -> None:
    """Refuse names that are no plain file names, and names that differ in the case of letters only.

    Raises
    ------
    CellError
        Such a name is among them, or none is there.
    """
    for name in names:
        if not _NAME.fullmatch(name):
            raise CellError(
                make_message("{name!r} is no name that every controller takes.", name=name[:80]),
                remedy="Use letters, digits, _ and one ending.",
                code="usage",
            )
    check_each_once(names)


def check_each_once(names: Sequence[str]) -> None:
    """Refuse no names at all, and names that differ in the case of letters only.

    Raises
    ------
    CellError
        With the cure.
    """
    if not names:
        raise CellError(
            "no program is named.", remedy="Name files, or a folder that holds some.", code="usage"
        )
    names_by_key: dict[str, str] = {}
    for name in names:
        if (other := names_by_key.setdefault(name.lower(), name)) is not name:
            raise CellError(
                make_message("{one} and {other} have one name for a controller.", one=other, other=name),
                remedy="Name one of them.",
                code="usage",
            )


@contextmanager
def hold_controller(copies: Path, address: str) -> Iterator[None]:
    """Hold a controller's programs alone among all that keep their copies in one folder.

    Two deliveries at once would each keep the other's half as what was there before.

    Raises
    ------
    DeliveryRefusedError
        Another delivery to it, or restoring, goes on.
    """
    host = host_of(address)
    # A digest, since a path may be longer than the name of a file.
    name = hashlib.sha256(host.encode(errors="replace")).hexdigest()[:32]
    with ExitStack() as lease:
        try:  # around the lease alone: a device that takes too long raises an OSError in the body, too
            lease.enter_context(acquire_lease(copies, name, "a delivery"))
        except LeaseHeldError as error:
            raise DeliveryRefusedError(
                make_message("{host}: another delivery or restoring of its programs goes on now.", host=host),
                remedy="Wait until that one has ended, then begin again.",
            ) from error
        except OSError as error:
            raise DeliveryRefusedError(
                make_message("{path} cannot be used: {reason}.", path=copies, reason=error.strerror or error),
                remedy="Give another folder with --copies.",
            ) from error
        yield


async def deliver_programs(
    open_store: OpenStore,
    new: Mapping[str, bytes],
    copies: Path,
    approval: Approval,
    address: str,
    *,
    on_copies: Callable[[StoredDelivery], None] | None = None,
) -> StoredDelivery:
    """Deliver programs; files that are there already are left as they are.

    ``on_copies`` learns where the copies are before the first write: a process that is killed names nothing later.

    Raises
    ------
    RefusedError
        A program runs; nothing was written.
    DeliveryRefusedError
        The controller does not tell whether one runs, and no person said that none does; nothing was written.
    DeliveryFailedError
        Something failed after the first write.
    DeviceError, DeliveryError
        Something failed before it.
    """
    check_names(list(new))
    stored: StoredDelivery | None = None
    touched: set[str] = set()
    with ExitStack() as stack:
        try:
            async with open_store() as store:
                _require_standing(store, approval)
                await store.refuse_while_running()
                old = {name: await store.read_file(name) for name in new}
                stack.enter_context(hold_controller(copies, address))
                stored = store_copies(copies, address, approval.approved_by, old, new)
                if on_copies is not None:
                    on_copies(stored)
                await _write_all(store, old, new, touched)
                return stored.with_state(DeliveryState.DELIVERED)
        except asyncio.CancelledError:
            if stored is not None:
                await run_to_end(_put_back_quietly(open_store, stored, touched))
            raise
        except CellError as failure:
            if stored is None:
                raise
            raise await _failed(open_store, stored, failure, touched) from failure


async def _write_all(
    store: ProgramStore, old: Mapping[str, bytes | None], new: Mapping[str, bytes], touched: set[str]
) -> None:
    """Write what is not there already; ``touched`` gets the name of each before it is written."""
    for name, content in new.items():
        if old[name] != content:
            await store.refuse_while_running()
            await _refuse_changed(store, name, old[name])
            touched.add(name)
            await _write_compared(store, name, content)


@dataclass(frozen=True, slots=True)
class RestoredPrograms:
    """A delivery that was taken back; ``replaced`` holds what the restoring replaced, None where nothing was."""

    put_back: StoredDelivery
    replaced: StoredDelivery | None


async def restore_programs(
    open_store: OpenStore, stored: StoredDelivery, approval: Approval, *, changed_too: bool = False
) -> RestoredPrograms:
    """Put back what was there before a delivery; what is there now is copied first, as a delivery beside this one.

    ``changed_too`` also replaces programs that are neither the old nor the delivered ones.

    Raises
    ------
    DeliveryRefusedError
        A program was changed since the delivery, or nothing tells whether one runs; nothing was written.
    DeviceError, DeliveryError
        As for ``deliver_programs``.
    """
    with hold_controller(stored.folder.parent, stored.delivery.address):
        return await _restore_alone(open_store, stored, approval, changed_too=changed_too)


async def _restore_alone(
    open_store: OpenStore, stored: StoredDelivery, approval: Approval, *, changed_too: bool
) -> RestoredPrograms:
    old = {file.name: stored.old_content(file) for file in stored.delivery.files}
    async with open_store() as store:
        _require_standing(store, approval)
        await store.refuse_while_running()
        found = {name: await store.read_file(name) for name in old}
        changed = [] if changed_too else _changed_since(store, stored, found)
        unchanged_names = {name for name in old if is_same_program(store, old[name], found[name])}
    if changed:
        raise DeliveryRefusedError(
            make_message(
                "{names}: changed on the controller since this delivery, or after it was put back.",
                names=", ".join(changed),
            ),
            remedy="Compare and fetch them first. To replace them all the same, after a copy, add --changed-too.",
        )
    if len(unchanged_names) == len(old):
        return RestoredPrograms(stored.with_state(DeliveryState.PUT_BACK), None)
    replaced = store_copies(stored.folder.parent, stored.delivery.address, approval.approved_by, found, old)
    return await run_to_end(_put_back_after_copy(open_store, stored, replaced))


async def _put_back_after_copy(
    open_store: OpenStore, stored: StoredDelivery, replaced: StoredDelivery
) -> RestoredPrograms:
    try:
        put_back = await _put_back(open_store, stored, {file.name for file in stored.delivery.files})
    except CellError:
        replaced.with_state(DeliveryState.UNKNOWN)
        raise
    return RestoredPrograms(put_back, replaced.with_state(DeliveryState.DELIVERED))


def _changed_since(
    store: ProgramStore, stored: StoredDelivery, found: Mapping[str, bytes | None]
) -> list[str]:
    """Return the programs that are neither the old nor the delivered ones, or no old ones once they were put back.

    A delivery that never ended may have left a beginning of what was sent, or nothing: that is no change of a person.
    """
    state = stored.delivery.state
    changed = []
    for file in stored.delivery.files:
        now, new = found[file.name], stored.new_content(file)
        is_sent = state is not DeliveryState.PUT_BACK and is_same_program(store, new, now)
        is_part = state is DeliveryState.BEGUN and new is not None and new.startswith(now or b"")
        if not (is_sent or is_part or is_same_program(store, stored.old_content(file), now)):
            changed.append(file.name)
    return changed


def is_same_program(store: ProgramStore, sent: bytes | None, found: bytes | None) -> bool:
    """Return whether a program and what a controller gives back are one; None is a program that is not there."""
    if sent is None or found is None:
        return sent is found
    return sent == found or store.is_same(sent, found)


async def _refuse_changed(store: ProgramStore, name: str, old: bytes | None) -> None:
    """Refuse where a program is another than its copy: another computer or a person at the pendant wrote it since."""
    if not is_same_program(store, old, await store.read_file(name)):
        raise RefusedError(
            store.device,
            make_message("{name} was changed on the controller while this delivery went on.", name=name),
            remedy="Find out who else works on its programs, then deliver again.",
        )


async def _write_compared(store: ProgramStore, name: str, content: bytes) -> None:
    await store.write_file(name, content)
    found = await store.read_file(name)
    if found is None or not store.is_same(content, found):
        raise RefusedError(
            store.device,
            make_message("{name} reads back as something else than was sent.", name=name),
            remedy="Compare the file with one that the controller wrote itself.",
        )


async def _put_back(open_store: OpenStore, stored: StoredDelivery, names: Collection[str]) -> StoredDelivery:
    """Write what was there before of these programs, read it back; the last failure is raised after some attempts."""
    for attempt in range(_ATTEMPTS):
        try:
            async with open_store() as store:
                for file in stored.delivery.files:
                    if file.name not in names:  # never written by this delivery
                        continue
                    await _put_back_file(store, file.name, stored.old_content(file))
            return stored.with_state(DeliveryState.PUT_BACK)
        except DeviceError as error:
            _LOG.warning("%s: putting back failed: %s", stored.delivery.address, error)
            if attempt + 1 == _ATTEMPTS:
                stored.with_state(DeliveryState.UNKNOWN)
                raise
            await asyncio.sleep(_PAUSE_S)
    raise AssertionError(_ATTEMPTS)


async def _put_back_file(store: ProgramStore, name: str, content: bytes | None) -> None:
    found = await store.read_file(name)
    if content is None:
        if found is not None:
            await store.delete_file(name)
            if await store.read_file(name) is not None:
                raise RefusedError(
                    store.device,
                    make_message("{name} was not there before and cannot be deleted.", name=name),
                    remedy="Delete it at the controller.",
                )
    elif found is None or not store.is_same(content, found):
        await _write_compared(store, name, content)


async def _put_back_quietly(open_store: OpenStore, stored: StoredDelivery, names: Collection[str]) -> None:
    try:
        await _put_back(open_store, stored, names)
    except CellError as error:
        _LOG.error("%s: the programs of before are not back: %s", stored.delivery.address, error)


async def _failed(
    open_store: OpenStore, stored: StoredDelivery, failure: CellError, touched: Collection[str]
) -> DeliveryFailedError:
    try:
        put_back = await run_to_end(_put_back(open_store, stored, touched))
    except CellError as error:
        return DeliveryFailedError(
            make_message(
                "the delivery failed, and what was there before could not be put back: {reason}",
                reason=error.message,
            ),
            stored.with_state(DeliveryState.UNKNOWN),
            remedy=make_message(
                "Run no program. When the controller answers again: cellcal program restore {folder}",
                folder=stored.folder,
            ),
        )
    if not touched:
        return DeliveryFailedError(
            make_message("the delivery failed, and nothing was written: {reason}", reason=failure.message),
            put_back,
            remedy=failure.remedy,
        )
    return DeliveryFailedError(
        make_message(
            "the delivery failed; what was there before is there again: {reason}", reason=failure.message
        ),
        put_back,
        remedy=failure.remedy,
    )


def _require_standing(store: ProgramStore, approval: Approval) -> None:
    if not store.tells_running and not approval.robot_stands:
        raise DeliveryRefusedError(
            make_message("{device}: nothing here tells whether a program runs.", device=store.device),
            remedy="Look that the robot stands and no program is selected, then add --robot-stands.",
        )
