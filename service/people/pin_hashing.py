"""PINs at rest: argon2id over a value that only who holds the pepper can compute.

All six-digit PINs can be tried within two days on one computer; a stolen list of people is worthless without the
pepper, so keep that apart: a systemd credential named ``cellcal-pepper``, or a file for its owner only.
"""

import hashlib
import hmac
import os
import secrets
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.calibration.message import make_message
from cellcal.service.files import create_file, make_private_folder
from cellcal.service.people.errors import PeopleError
from cellcal.service.unexpected_errors import explain_os_error

PEPPER_BYTES = 32
PEPPER_NAME = "pepper.key"
CREDENTIAL = "cellcal-pepper"
MEMORY_KIB, PASSES, LANES = 64 * 1024, 3, 4


def make_argon2id() -> PasswordHasher:
    """Return the hasher: argon2id, 64 MiB, 3 passes, 4 lanes."""
    return PasswordHasher(time_cost=PASSES, memory_cost=MEMORY_KIB, parallelism=LANES)


@dataclass(frozen=True)
class PinHasher:
    """Hashes and checks what people know."""

    pepper: bytes
    argon2: PasswordHasher = field(default_factory=make_argon2id)

    @property
    def pepper_mark(self) -> str:
        """A mark that tells this pepper from another without revealing it."""
        return hmac.new(self.pepper, b"cellcal pepper mark", hashlib.sha256).hexdigest()

    def hash_secret(self, secret: str) -> str:
        """Return what to keep of a PIN or passphrase."""
        return self.argon2.hash(self._add_pepper(secret))

    def is_right(self, pin_hash: str, secret: str) -> bool:
        """Whether a PIN or passphrase is the one that was kept."""
        try:
            return self.argon2.verify(pin_hash, self._add_pepper(secret))
        except (VerificationError, InvalidHashError):
            return False

    def _add_pepper(self, secret: str) -> bytes:
        return hmac.new(self.pepper, secret.encode(), hashlib.sha256).digest()


def pepper_of(data_dir: Path) -> bytes:
    """Return the installation's pepper; create the file at first use, never over another.

    Raises
    ------
    PeopleError
        It cannot be read, other users may read it, or it is no pepper.
    """
    credentials_folder = os.environ.get("CREDENTIALS_DIRECTORY")
    credential = Path(credentials_folder) / CREDENTIAL if credentials_folder else None
    try:
        if credential is not None and credential.exists():
            return _check_length(credential, read_plain_bytes(credential))
        path = data_dir / PEPPER_NAME
        if not path.exists():
            _create_pepper(path)
        if path.stat().st_mode & 0o077:
            raise PeopleError(
                make_message("other users of this computer may read {path}.", path=path),
                remedy=make_message("Run: chmod 600 {path}", path=path),
            )
        return _check_length(path, read_plain_bytes(path))
    except OSError as error:
        raise PeopleError(
            make_message(
                "the pepper in {data_dir} cannot be used: {strerror}.",
                data_dir=data_dir,
                strerror=error.strerror,
            ),
            remedy=explain_os_error(error)[1],
        ) from error


def _check_length(path: Path, pepper: bytes) -> bytes:
    if len(pepper) != PEPPER_BYTES:
        raise PeopleError(
            make_message(
                "{path} holds {pepper_count} bytes, not the {pepper_bytes} of a pepper.",
                path=path,
                pepper_count=len(pepper),
                pepper_bytes=PEPPER_BYTES,
            ),
            remedy="Restore it from a backup; without it every PIN has to be set anew.",
        )
    return pepper


def _create_pepper(path: Path) -> None:
    """Write it whole or not at all, and never over the one of a quicker process."""
    make_private_folder(path.parent)
    with suppress(FileExistsError):
        create_file(path, secrets.token_bytes(PEPPER_BYTES))
