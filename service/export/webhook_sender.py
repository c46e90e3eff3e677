"""Sends a cell's alarms to a receiver; a process of its own beside the service. People are told, nothing acts on it.

One thread looks for alarms and puts them on disk, another delivers, oldest first, for as long as it takes. Signed as
"Standard Webhooks" (standardwebhooks.com, 1.0.0) says: ``webhook-id`` stays the same however often an event is sent,
so a receiver that has seen it drops it; ``webhook-signature`` is ``v1,`` and the base64 of HMAC-SHA256 over
``id.timestamp.body``.
"""

import base64
import binascii
import fcntl
import hashlib
import hmac
import logging
import os
import random
import secrets
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import BinaryIO

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import message_and_remedy_of, start_thread
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.configuration.report_tables import WebhookTable
from cellcal.service.export.webhook_outbox import OUTBOX_NAME, WebhookOutbox
from cellcal.service.export.webhook_target import WebhookError, WebhookTarget, deliver_event, target_of
from cellcal.service.files import make_private_folder
from cellcal.service.site.cell_alarms import CellAlarmWatch
from cellcal.service.site.cell_state import DueDates
from cellcal.service.site.controller_tap import ControllerTap
from cellcal.service.unexpected_errors import log_in_lines, run_guarded

_LOG = logging.getLogger(__name__)
PERIOD_S = 0.1
FIRST_RETRY_S, LONGEST_RETRY_S = 1.0, 300.0
REFUSALS = 5  # of one event, before later ones get their turn
_NOT_UNDERSTOOD = frozenset({400, 413, 415, 422})  # it is about this event; all else is about the receiver
SECRET_PREFIX = "whsec_"
_SECRET_BYTES, _FEWEST_SECRET_BYTES = 32, 24


def signed_headers(secret: bytes, event_id: str, body: bytes, now_s: float) -> dict[str, str]:
    """Return the headers of one delivery."""
    stamp = str(int(now_s))
    signed = b".".join((event_id.encode(), stamp.encode(), body))
    value = base64.b64encode(hmac.new(secret, signed, hashlib.sha256).digest()).decode()
    return {
        "content-type": "application/json",
        "user-agent": "cellcal",
        "webhook-id": event_id,
        "webhook-timestamp": stamp,
        "webhook-signature": f"v1,{value}",
    }


def new_secret() -> str:
    """Return a secret as a file holds it."""
    return SECRET_PREFIX + base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode()


def read_secret(path: Path) -> bytes:
    """Return the secret of a file.

    Raises
    ------
    WebhookError
        It cannot be read, others may read it, or it is none.
    """
    try:
        if path.stat().st_mode & 0o077:
            raise WebhookError(
                make_message("other users of this computer may read {path}.", path=path),
                remedy=make_message("Run: chmod 600 {path}", path=path),
                code="usage",
            )
        text = read_plain_text(path).strip().removeprefix(SECRET_PREFIX)
        secret = base64.b64decode(text, validate=True)
    except OSError as error:
        raise WebhookError(
            f"the webhook's secret {path} cannot be read: {error.strerror}.",
            remedy=f"Make one with `cellcal webhooks secret {path}`, and give it to the receiver.",
            code="usage",
        ) from error
    except (ValueError, binascii.Error) as error:
        raise _no_secret(path) from error
    if len(secret) < _FEWEST_SECRET_BYTES:
        raise _no_secret(path)
    return secret


class WebhookDelivery:
    """Takes event after event from the outbox to the receiver."""

    def __init__(self, outbox: WebhookOutbox, target: WebhookTarget, secret: bytes) -> None:
        self._outbox, self._target, self._secret = outbox, target, secret
        self._failures = 0

    def deliver_next(self) -> float:
        """Try the oldest event; return after how many seconds to go on."""
        event = self._outbox.next_event()
        if event is None:
            return PERIOD_S
        try:
            status = deliver_event(
                self._target, event.body, signed_headers(self._secret, event.id, event.body, time.time())
            )
        except WebhookError as error:
            return self._retry_later(error.message)
        if 200 <= status < 300:
            self._failures = 0
            self._outbox.mark_delivered(event)
            return 0.0
        if status in _NOT_UNDERSTOOD:
            at_last = event.refusals + 1 >= REFUSALS
            self._outbox.mark_refused(event, f"the receiver answers {status}.", at_last=at_last)
            return 0.0 if at_last else self._wait_s()
        redirect = " That is a redirect: give the address it leads to." if 300 <= status < 400 else ""
        return self._retry_later(f"the receiver answers {status}.{redirect}")

    def _retry_later(self, why: str) -> float:
        if self._failures == 0:
            _LOG.warning("%s It is tried again.", why)
        self._outbox.note_failure(why)
        return self._wait_s()

    def _wait_s(self) -> float:
        wait_s = min(FIRST_RETRY_S * 2.0**self._failures, LONGEST_RETRY_S)
        self._failures = min(self._failures + 1, 20)
        return wait_s * random.uniform(0.75, 1.25)  # many cells do not come at once


def run_sender(config: CellConfig, stream: BinaryIO | None, leave: threading.Event) -> None:
    """Send a cell's alarms until ``leave`` is set, or the stream of the cell process's messages ends.

    Raises
    ------
    WebhookError
        The cell file has no usable ``[webhook]``, or another process sends already.
    """
    table = webhook_of(config)
    target, secret = target_of(table), read_secret(table.secret_file)
    with _exclusive_lock(config.cell.data_dir), WebhookOutbox(config.cell.data_dir) as outbox:
        ended = threading.Event()
        carry = partial(_deliver_forever, config.cell.data_dir, target, secret, ended)
        program_transfer = start_thread("webhook: delivery", carry, ended)
        try:
            _collect_alarms(config, ControllerTap(stream), outbox, leave)
        finally:
            ended.set()
            program_transfer.join(PERIOD_S)  # a delivery that hangs is begun anew at the next start


def webhook_of(config: CellConfig) -> WebhookTable:
    """Return the ``[webhook]`` table of a cell file, or raise WebhookError where there is none."""
    if config.reports.webhook is None:
        raise WebhookError(
            f"{config.path} has no [webhook] table.",
            remedy='Add [webhook] with url = "https://…" and secret_file = "…".',
            code="usage",
        )
    return config.reports.webhook


def _collect_alarms(
    config: CellConfig, tap: ControllerTap, outbox: WebhookOutbox, leave: threading.Event
) -> None:
    now_s = time.monotonic()
    troubles = CellAlarmWatch(
        config, tap, DueDates(config), initial=outbox.active_alarms(), now_s=now_s, awaits_cell_process=True
    )
    while not (leave.is_set() or tap.ended.is_set()):
        changes = troubles.update_alarms(time.monotonic())
        if changes:
            outbox.add_changes(config.cell.name, changes)
        leave.wait(PERIOD_S)


def _deliver_forever(data_dir: Path, target: WebhookTarget, secret: bytes, ended: threading.Event) -> None:
    with WebhookOutbox(data_dir) as outbox:
        delivery = WebhookDelivery(outbox, target, secret)
        while not ended.wait(delivery.deliver_next()):
            pass


@contextmanager
def _exclusive_lock(data_dir: Path) -> Iterator[None]:
    make_private_folder(data_dir)
    path = (data_dir / OUTBOX_NAME).with_suffix(".lock")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise WebhookError(
            "another process already sends this cell's alarms.", remedy="End one of the two.", code="busy"
        ) from error
    finally:
        os.close(descriptor)


def _no_secret(path: Path) -> WebhookError:
    return WebhookError(
        f"{path} holds no secret of a webhook: {SECRET_PREFIX} and base64 of {_FEWEST_SECRET_BYTES} bytes or more.",
        remedy="Make one with `cellcal webhooks secret FILE`.",
        code="usage",
    )


def main(path: str) -> None:
    """Send alarms until standard input ends."""
    log_in_lines("webhook: %(message)s")
    try:
        run_sender(read_cell_file(path), sys.stdin.buffer, threading.Event())
    except CellError as error:
        _LOG.error("%s %s", error.message, error.remedy)
        raise SystemExit(2) from None
    except Exception as error:  # noqa: BLE001  whatever it was, the service names it
        _LOG.exception("the sender of alarms failed")
        _LOG.error("%s %s", *message_and_remedy_of(error))  # the last line is what the service shows
        raise SystemExit(70) from None


if __name__ == "__main__":
    sys.exit(run_guarded(lambda: main(sys.argv[1])))
