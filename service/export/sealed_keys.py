"""Secret keys in a backup: AES-256-GCM under a key that argon2id makes of a passphrase."""

import base64
import json
import secrets
from collections.abc import Mapping

from argon2.low_level import Type, hash_secret_raw
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from cellcal.calibration.documents.json_text import parse_json
from cellcal.service.export.archive import BackupError
from cellcal.service.people.pin_hashing import LANES, MEMORY_KIB, PASSES

FORMAT = "cellcal sealed keys 1"
SHORTEST = 12  # characters
_SALT_BYTES, _NONCE_BYTES, _KEY_BYTES = 16, 12, 32


def seal_keys(keys: Mapping[str, bytes], passphrase: str) -> bytes:
    """Return keys, by their file names, so that only who knows the passphrase reads them."""
    if len(passphrase) < SHORTEST:
        raise BackupError(
            f"a passphrase for keys has at least {SHORTEST} characters.",
            remedy="Take a longer one.",
            code="usage",
        )
    salt, nonce = secrets.token_bytes(_SALT_BYTES), secrets.token_bytes(_NONCE_BYTES)
    plain = json.dumps({name: _encode_text(raw) for name, raw in keys.items()}).encode()
    sealed = AESGCM(_derive_key(passphrase, salt)).encrypt(nonce, plain, FORMAT.encode())
    fields = {
        "format": FORMAT,
        "salt": _encode_text(salt),
        "nonce": _encode_text(nonce),
        "sealed": _encode_text(sealed),
    }
    return json.dumps(fields).encode()


def open_keys(raw: bytes, passphrase: str) -> dict[str, bytes]:
    """Return the keys by their file names.

    Raises
    ------
    BackupError
        It is another passphrase, or the file was changed.
    """
    try:
        fields = parse_json(raw)
        salt, nonce, sealed = (base64.b64decode(fields[part]) for part in ("salt", "nonce", "sealed"))
        plain = AESGCM(_derive_key(passphrase, salt)).decrypt(nonce, sealed, FORMAT.encode())
        return {str(name): base64.b64decode(text) for name, text in parse_json(plain).items()}
    except (ValueError, KeyError, TypeError, InvalidTag) as error:
        raise BackupError(
            "the keys in this backup cannot be opened: it is another passphrase, or they were changed.",
            remedy="Give the passphrase with which the backup was made, or restore without the keys.",
            code="signature",
        ) from error


def _derive_key(passphrase: str, salt: bytes) -> bytes:
    secret = passphrase.encode()
    return hash_secret_raw(secret, salt, PASSES, MEMORY_KIB, LANES, _KEY_BYTES, Type.ID)


def _encode_text(raw: bytes) -> str:
    return base64.b64encode(raw).decode()
