"""Signed messages: what a cell says on the bus, so that not even the router can say it in the cell's name.

A message is one JSON object {body, ed25519, epoch, key, seq, station, wall}. The signature is over the canonical JSON
of the rest. ``key`` is the key it was published under: a message is good there and nowhere else. ``epoch`` names the
outbox that counted ``seq``: a cell that lost its outbox begins a later epoch, and nothing is taken for a repetition.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.message import make_message
from cellcal.procedures.canonical_json import canonical_json
from cellcal.service.record.signing import CellKey
from cellcal.service.times import read_time

LONGEST_MESSAGE = 2_000_000
ENCODING = "application/json;schema=cellcal.sealed.v1"
_PARTS = {"body", "ed25519", "epoch", "key", "seq", "station", "wall"}


@dataclass(frozen=True, slots=True)
class SignedMessage:
    """A message of a cell, its signature checked."""

    station: str
    epoch: str
    seq: int
    wall: str
    key: str
    body: Any

    @property
    def order_key(self) -> tuple[str, int]:
        """Where it stands in the order of what was said; an older epoch stands before a newer one."""
        return self.epoch, self.seq


@dataclass(frozen=True, slots=True)
class MessageFlaw:
    """Why a message is not believed."""

    key: str
    sentence: str


@dataclass(frozen=True, slots=True)
class MessageSigner:
    """Signs in the name of one station."""

    key: CellKey
    station: str
    epoch: str

    def sign_message(self, key: str, seq: int, body: Mapping[str, Any], wall: str | None = None) -> bytes:
        """Return a message as it goes over the wire.

        Raises
        ------
        ValueError
            The body holds NaN or infinity.
        """
        fields = {
            "body": body,
            "epoch": self.epoch,
            "key": key,
            "seq": seq,
            "station": self.station,
            "wall": wall or wall_utc(),
        }
        signed = canonical_json(fields)
        signature = self.key.private.sign(signed.encode()).hex()
        return f'{signed[:-1]},"ed25519":"{signature}"}}'.encode()


def wall_utc() -> str:
    """Return the time of day as messages carry it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def public_key(hexadecimal: str) -> Ed25519PublicKey:
    """Return a station's public key from its 64 hexadecimal digits."""
    return Ed25519PublicKey.from_public_bytes(bytes.fromhex(hexadecimal))


def open_message(raw: bytes, key: str, station: str, public: Ed25519PublicKey) -> SignedMessage | MessageFlaw:
    """Check a message that arrived under a key, and return what it says or why it is not believed."""
    if len(raw) > LONGEST_MESSAGE:
        return MessageFlaw(
            key, make_message("a message of {raw_count} bytes is longer than any of ours", raw_count=len(raw))
        )
    try:
        fields = parse_json(raw)
    except (ValueError, RecursionError):
        return MessageFlaw(key, "a message is no JSON")
    if not isinstance(fields, dict) or fields.keys() != _PARTS or not _has_right_types(fields):
        return MessageFlaw(key, "a message has not the parts of a signed one")
    signature = fields.pop("ed25519")
    try:
        sealed = bytes.fromhex(signature)
        if sealed.hex() != signature:
            raise InvalidSignature  # written in another way than it was sealed
        public.verify(sealed, canonical_json(fields).encode())
    except (InvalidSignature, ValueError, RecursionError):
        return MessageFlaw(
            key, "the signature does not belong to the message: it was changed, or another key signed it"
        )
    if (fields["key"], fields["station"]) != (key, station):
        return MessageFlaw(
            key,
            make_message(
                "a message that {station} signed for {signed_key} was put here",
                station=fields["station"],
                signed_key=fields["key"],
            ),
        )
    return SignedMessage(station, fields["epoch"], fields["seq"], fields["wall"], key, fields["body"])


def _has_right_types(fields: Mapping[str, Any]) -> bool:
    texts = all(isinstance(fields[key], str) for key in ("ed25519", "epoch", "key", "station", "wall"))
    seq = fields["seq"]
    if not texts or not _is_moment(fields["wall"]):
        return False
    return isinstance(seq, int) and not isinstance(seq, bool) and 0 < seq < 2**63


def _is_moment(wall: str) -> bool:
    try:
        read_time(wall)
    except ValueError:
        return False
    return True
