"""Signed documents of one cell: canonical JSON with its SHA-256 and an ed25519 signature, checked offline.

A document is one JSON object, written in exactly one way (``procedures/canonical_json.py``) and ended by a newline::

    {"content": …, "format": "cellcal certificate 1", "sha256": …, "signature": {"algorithm": "ed25519",
     "public_key": …, "value": …}}

``sha256`` is of the canonical content; the signature is over the canonical object without ``signature``. Nothing
in a document depends on when it is written, so the same run gives the same bytes.

To check one without this program: parse it, take "signature" out, write the rest with sorted keys and without
blanks, and verify that text with the public key (hexadecimal, 32 bytes).
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes, read_plain_text
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.procedures.canonical_json import canonical_json, sha256_of
from cellcal.service.files import create_file, make_private_folder

KEY_NAME = "signing_key.pem"
_ALGORITHM = "ed25519"
_MOST_BYTES = 64_000_000
_PARTS = {"content", "format", "sha256", "signature"}
_SIGNATURE_PARTS = {"algorithm", "public_key", "value"}


class SigningError(CellError):
    """A signing key or a signed document cannot be used."""

    code = "signature"


class CheckFinding(StrEnum):
    """The outcome of a check of a signed document."""

    INTACT = "intact"
    TAMPERED = "tampered"
    UNKNOWN_KEY = "unknown_key"
    UNREADABLE = "unreadable"


@dataclass(frozen=True, slots=True)
class CheckedDocument:
    """The end of a check. ``content`` is given only where the document is intact."""

    finding: CheckFinding
    sentence: str
    format: str = ""
    sha256: str = ""
    public_key: str = ""
    content: Any = None


@dataclass(frozen=True)
class CellKey:
    """The key of one cell. Who has it can sign in the cell's name."""

    path: Path
    private: Ed25519PrivateKey
    created: bool  # by this very call

    @property
    def public_key(self) -> str:
        """Public key in hexadecimal."""
        return self.private.public_key().public_bytes_raw().hex()

    @property
    def open_to_others(self) -> bool:
        """Whether other users of this computer may read the key."""
        return bool(self.path.stat().st_mode & 0o077)

    def sign_document(self, kind: str, content: Mapping[str, Any]) -> str:
        """Return the signed document as text.

        Raises
        ------
        SigningError
            The content holds a number that is not finite, or something that is no JSON.
        """
        try:
            body = {"content": content, "format": kind, "sha256": sha256_of(content)}
            signature = self.private.sign(canonical_json(body).encode())
        except (ValueError, TypeError) as error:
            raise SigningError(
                make_message("this cannot be signed: {error}.", error=error), remedy="Report this."
            ) from error
        signature_fields = {"algorithm": _ALGORITHM, "public_key": self.public_key, "value": signature.hex()}
        return canonical_json(body | {"signature": signature_fields}) + "\n"


def station_key(data_dir: Path) -> CellKey:
    """Return the cell's key; create it at first use, readable by its owner only, never over another.

    Raises
    ------
    SigningError
        The file is there and holds no such key, or cannot be read or written.
    """
    path = data_dir / KEY_NAME
    try:
        created = _create_key(path) if not path.exists() else False
        private = serialization.load_pem_private_key(read_plain_bytes(path), password=None)
    except OSError as error:
        raise SigningError(
            make_message(
                "the signing key {path} cannot be used: {strerror}.", path=path, strerror=error.strerror
            ),
            remedy="Let the user who runs cellcal read it; no other user may read it.",
        ) from error
    except (ValueError, TypeError) as error:
        raise _damaged_key_error(path) from error
    if not isinstance(private, Ed25519PrivateKey):
        raise _damaged_key_error(path)
    return CellKey(path, private, created)


_BEGINNING = b'{"content":'
_NO_FACT = "It holds a number that is not finite, or text that cannot be written."


def read_public_key(text: str) -> str:
    """Return a public key in hexadecimal from what a person gave: the key itself, or a file that holds it.

    Raises
    ------
    SigningError
        Neither.
    """
    key_text = text.strip()
    if not _is_hex(key_text.lower(), 64):
        key_text = _text_of_key_file(Path(key_text))
    if "BEGIN PUBLIC KEY" in key_text:
        try:
            public = serialization.load_pem_public_key(key_text.encode())
        except ValueError as error:
            raise _no_key(text) from error
        key_text = public.public_bytes_raw().hex() if isinstance(public, Ed25519PublicKey) else ""
    if not _is_hex(key_text.lower(), 64):
        raise _no_key(text)
    return key_text.lower()


def read_document(path: Path) -> bytes | CheckedDocument:
    """Return the bytes of a document, or why they cannot be read."""
    try:
        return read_plain_bytes(path, _MOST_BYTES)
    except (OSError, ValueError) as error:
        return _unreadable_document(
            make_message(
                "It cannot be read: {getattr}.",
                getattr=str(getattr(error, "strerror", None) or error).rstrip("."),
            )
        )


def check_document(raw: bytes, *, expected_key: str | None = None) -> CheckedDocument:
    """Check a signed document to the last byte.

    Parameters
    ----------
    raw : bytes
        The whole file.
    expected_key : str, optional
        Public key in hexadecimal that must have signed it. Without it, nothing is said about who signed.
    """
    try:
        document = _parse_document(raw)
    except DocumentError:
        return CheckedDocument(CheckFinding.TAMPERED, _NO_FACT)
    if document is None:
        return _unreadable_document(
            "This is no document that cellcal signed, or damaged beyond reading. Give the JSON file, not the text."
        )
    signature, body = document["signature"], {key: document[key] for key in _PARTS - {"signature"}}
    key = str(signature["public_key"])
    facts = (str(document["format"]), str(document["sha256"]), key)
    wrong = _what_is_wrong(raw, document, body)
    if wrong:
        return CheckedDocument(CheckFinding.TAMPERED, wrong, *facts)
    if expected_key is not None and key != expected_key.lower():
        return CheckedDocument(
            CheckFinding.UNKNOWN_KEY,
            "It is unchanged since it was signed, but another key signed it than the one given.",
            *facts,
        )
    return CheckedDocument(
        CheckFinding.INTACT, "It is unchanged since it was signed.", *facts, document["content"]
    )


def _what_is_wrong(raw: bytes, document: dict[str, Any], body: dict[str, Any]) -> str:
    try:
        written = canonical_json(document).encode() + b"\n"
        signed = canonical_json(body).encode()
        found = sha256_of(document["content"])
    except (ValueError, RecursionError):
        return _NO_FACT
    if written != raw:
        return "It is not written as it was signed: a byte was changed, added or taken away."
    if found != document["sha256"]:
        return "Its content is not the one that was signed (SHA-256)."
    return (
        "" if _is_signed(document["signature"], signed) else "The signature does not belong to this content."
    )


def _is_signed(signature: dict[str, Any], signed: bytes) -> bool:
    key, value = signature["public_key"], signature["value"]
    if signature["algorithm"] != _ALGORITHM or not (_is_hex(key, 64) and _is_hex(value, 128)):
        return False
    try:
        Ed25519PublicKey.from_public_bytes(bytes.fromhex(key)).verify(bytes.fromhex(value), signed)
    except (InvalidSignature, ValueError):
        return False
    return True


def _parse_document(raw: bytes) -> dict[str, Any] | None:
    try:
        document = parse_json(raw)
    except DocumentError as error:
        if error.__cause__ is None and raw.startswith(_BEGINNING) and raw.endswith(b"}\n"):
            raise  # JSON all through, and nothing that was ever signed
        return None
    if not isinstance(document, dict) or document.keys() != _PARTS:
        return None
    signature = document["signature"]
    return document if isinstance(signature, dict) and signature.keys() == _SIGNATURE_PARTS else None


def _is_hex(value: Any, length: int) -> bool:
    return isinstance(value, str) and len(value) == length and all(c in "0123456789abcdef" for c in value)


def _create_key(path: Path) -> bool:
    """Put a new key where none is: written beside it, then named, so that a crash leaves none or a whole one."""
    make_private_folder(path.parent)
    pem = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    try:
        create_file(path, pem)
    except FileExistsError:
        return False  # another cellcal was quicker: its key it is
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
    return True


def _text_of_key_file(path: Path) -> str:
    try:
        return read_plain_text(path).strip()
    except (OSError, ValueError) as error:
        raise _no_key(str(path)) from error


def _no_key(text: str) -> SigningError:
    return SigningError(
        make_message("{text!r} is no public key and no file that holds one.", text=text),
        remedy="Give the 64 hexadecimal digits that `cellcal certificate key --cell CELL` prints, or a file of them.",
        code="usage",
    )


def _damaged_key_error(path: Path) -> SigningError:
    return SigningError(
        make_message("{path} holds no signing key of cellcal.", path=path),
        remedy="Restore it from a backup of data_dir. If there is none, move the file away: a new key is made at the "
        "next certificate, and those signed before stay good with the old public key.",
    )


def _unreadable_document(sentence: str) -> CheckedDocument:
    return CheckedDocument(CheckFinding.UNREADABLE, sentence)
