"""A device proves that it is the enrolled one: ES256 (ECDSA on P-256 with SHA-256) over a challenge.

The key is made in the browser (WebCrypto) and cannot be taken out of it. What is signed names the address that
the browser sees, so that a false service cannot pass the answer on to the true one.
"""

import base64
import binascii
import secrets
import time
from collections.abc import Callable

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from cellcal.service.people.errors import WrongSecretError

CHALLENGE_S = 60.0
_MOST = 1000
_PART = 32


def public_key_of(spki: str) -> bytes:
    """Return the public key that a browser exported ("spki", base64url), checked to be one on P-256.

    Raises
    ------
    WrongSecretError
        It is none.
    """
    try:
        key = serialization.load_der_public_key(from_base64url(spki))
    except (ValueError, UnsupportedAlgorithm) as error:
        raise _no_key() from error
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise _no_key()
    return key.public_bytes(serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo)


def signed_text(origin: str, challenge: str) -> bytes:
    """Return what a device signs: the purpose, the address it sees (scheme://host:port), the challenge."""
    return f"cellcal device sign-in\n{origin}\n{challenge}".encode()


def is_signed(key: bytes, signature: str, text: bytes) -> bool:
    """Whether ``signature`` (r and s, 32 bytes each, base64url, as WebCrypto gives it) is the key's."""
    public = serialization.load_der_public_key(key)
    assert isinstance(public, ec.EllipticCurvePublicKey)
    try:
        raw = from_base64url(signature)
        if len(raw) != 2 * _PART:
            return False
        r, s = int.from_bytes(raw[:_PART], "big"), int.from_bytes(raw[_PART:], "big")
        public.verify(encode_dss_signature(r, s), text, ec.ECDSA(hashes.SHA256()))
    except (InvalidSignature, ValueError):
        return False
    return True


class Challenges:
    """Questions to devices: each answered once, within a minute."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._open_challenges: dict[str, float] = {}

    def create_challenge(self) -> str:
        """Return a new challenge."""
        while len(self._open_challenges) >= _MOST:
            self._open_challenges.pop(next(iter(self._open_challenges)))
        challenge = secrets.token_urlsafe(32)
        self._open_challenges[challenge] = self._clock()
        return challenge

    def use_challenge(self, challenge: str) -> bool:
        """Whether the challenge was asked just now; it counts no second time."""
        asked_s = self._open_challenges.pop(challenge, None)
        return asked_s is not None and self._clock() - asked_s <= CHALLENGE_S


def from_base64url(text: str) -> bytes:
    """Return the bytes of base64url text, with or without padding; ValueError where it is none."""
    try:
        return base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except binascii.Error as error:
        raise ValueError(str(error)) from error


def _no_key() -> WrongSecretError:
    return WrongSecretError("the device's key", "Open the enrolment address in an up-to-date browser.")
