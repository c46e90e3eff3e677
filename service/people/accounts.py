"""Who is known here: people, enrolled devices, wrong guesses, and what was changed by whom; one SQLite file.

Nothing is deleted: a person who left keeps the name, so that a signature of last year names one person only.
Every call opens the file anew: what `cellcal people` changes counts in the running service at once.
"""

import errno
import hashlib
import os
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.service.files import make_private_folder
from cellcal.service.people.errors import PeopleError, TooManyGuessesError, WrongSecretError
from cellcal.service.people.naming import clean_name, fold_name
from cellcal.service.people.rate_limits import DAY_S, DEVICE, PERSON, STATION, wait_s
from cellcal.service.people.roles import Role
from cellcal.service.record.database_setup import primary_code
from cellcal.service.times import steady_time
from cellcal.service.unexpected_errors import explain_os_error

REGISTER_NAME = "people.db"
ENROL_S = 600.0
_LATEST_END_S = 2 * ENROL_S  # an invitation that ends later was made before the clock was set back
_BUSY_S = 5.0
_VERSION = 1
_TABLES = """
CREATE TABLE person (name TEXT PRIMARY KEY, folded TEXT NOT NULL UNIQUE, role TEXT NOT NULL, kept TEXT NOT NULL,
    epoch INTEGER NOT NULL, removed_at REAL) STRICT;
CREATE TABLE device (id TEXT PRIMARY KEY, name TEXT NOT NULL, key BLOB NOT NULL, enrolled_at REAL NOT NULL,
    revoked_at REAL) STRICT;
CREATE TABLE enrolment (token TEXT PRIMARY KEY, name TEXT NOT NULL, until REAL NOT NULL) STRICT;
CREATE TABLE failure (id INTEGER PRIMARY KEY, at REAL NOT NULL, person TEXT NOT NULL, device TEXT NOT NULL,
    cleared INTEGER NOT NULL DEFAULT 0) STRICT;
CREATE TABLE event (at REAL NOT NULL, who TEXT NOT NULL, what TEXT NOT NULL) STRICT;
CREATE TABLE mark (pepper TEXT NOT NULL) STRICT;
"""
_SYSTEM_NUMBERS = {sqlite3.SQLITE_FULL: errno.ENOSPC, sqlite3.SQLITE_READONLY: errno.EROFS}


@dataclass(frozen=True, slots=True)
class Account:
    """A person. ``epoch`` grows when the PIN or the role changes: sessions of an earlier one have ended."""

    name: str
    role: Role
    pin_hash: str
    epoch: int


@dataclass(frozen=True, slots=True)
class EnrolledDevice:
    """An enrolled device: the public half of a key that never leaves its browser."""

    id: str
    name: str
    key: bytes
    enrolled_at: float


class AccountStore:
    """The file, read and written in short transactions; ``clock`` is the time of day in seconds.

    By default waits for a PIN go by a clock of their own: setting the computer's changes none of them.
    """

    def __init__(self, data_dir: Path, clock: Callable[[], float] | None = None) -> None:
        self.path = data_dir / REGISTER_NAME
        self._clock, self._guess_clock = clock or time.time, clock or steady_time

    # people

    def list_people(self) -> tuple[Account, ...]:
        """Return all people who may sign in, by name."""
        rows = self._query_rows(
            "SELECT name, role, kept, epoch FROM person WHERE removed_at IS NULL ORDER BY folded"
        )
        return tuple(Account(name, Role(role), pin_hash, epoch) for name, role, pin_hash, epoch in rows)

    def find_person(self, name: str) -> Account | None:
        """Return one person, None when no person of that name may sign in."""
        sought = fold_name(name)
        return next((each for each in self.list_people() if fold_name(each.name) == sought), None)

    def add_person(self, name: str, role: Role, pin_hash: str, by: str) -> str:
        """Add a person; return the name as it is kept. A name is never given twice, not even after years."""
        clean = clean_name(name)
        with self._write_transaction(by, f"add {role} {clean}") as at:
            taken = at.execute(
                "SELECT removed_at FROM person WHERE folded = ?", (fold_name(clean),)
            ).fetchone()
            if taken is not None:
                removed_note = " (left since)" if taken[0] is not None else ""
                raise PeopleError(
                    make_message(
                        "there is a {clean} already{removed_note}.", clean=clean, removed_note=removed_note
                    ),
                    remedy="Give another name: names stand in signatures.",
                )
            at.execute(
                "INSERT INTO person VALUES (?, ?, ?, ?, 1, NULL)", (clean, fold_name(clean), role, pin_hash)
            )
        return clean

    def remove_person(self, name: str, by: str) -> None:
        """Let a person sign in no longer; what runs goes on."""
        self._change_person(name, by, "remove", "removed_at = ?", (self._clock(),))

    def reset_person(self, name: str, role: Role, pin_hash: str, by: str) -> None:
        """Set a person's PIN and role anew and forget wrong guesses."""
        account = self._change_person(name, by, f"reset to {role}", "kept = ?, role = ?", (pin_hash, role))
        with self._write_transaction(by, f"clear guesses of {account.name}") as at:
            at.execute("DELETE FROM failure WHERE person = ?", (fold_name(account.name),))

    def _change_person(
        self, name: str, by: str, what: str, change: str, values: tuple[object, ...]
    ) -> Account:
        account = self.find_person(name)
        if account is None:
            raise PeopleError(
                make_message("there is no {name!r} here.", name=name),
                remedy="`cellcal people list` lists all people.",
            )
        with self._write_transaction(by, f"{what} {account.name}") as at:
            at.execute(
                f"UPDATE person SET {change}, epoch = epoch + 1 WHERE name = ?", (*values, account.name)
            )
        return account

    # the pepper

    def hold_to_pepper(self, mark: str) -> None:
        """Note the first pepper; refuse another: with it every right PIN would look wrong.

        Raises
        ------
        PeopleError
            The PINs were kept with another pepper.
        """
        noted = self._query_rows("SELECT pepper FROM mark")
        if not noted:
            with self._write_transaction("cellcal", "first pepper") as at:
                at.execute("INSERT INTO mark VALUES (?)", (mark,))
        elif noted[0][0] != mark:
            raise PeopleError(
                make_message("the PINs in {path} were kept with another pepper.", path=self.path),
                remedy="Restore the pepper from the backup, or set every PIN anew in a new register.",
            )

    # devices

    def create_enrolment(self, name: str, by: str) -> str:
        """Return a token with which one device can be enrolled once, within ten minutes."""
        token = secrets.token_urlsafe(32)
        clean = clean_name(name)
        with self._write_transaction(by, f"invite device {clean}") as at:
            now = self._clock()
            at.execute("DELETE FROM enrolment WHERE until NOT BETWEEN ? AND ?", (now, now + _LATEST_END_S))
            at.execute("INSERT INTO enrolment VALUES (?, ?, ?)", (_hash_token(token), clean, now + ENROL_S))
        return token

    def enrol_device(self, token: str, key: bytes) -> EnrolledDevice:
        """Keep a device's public key and use its token up.

        Raises
        ------
        WrongSecretError
            The token is unknown, used or too old.
        """
        with self._write_transaction("enrolment", "enrol a device") as at:
            now = self._clock()
            row = at.execute(
                "DELETE FROM enrolment WHERE token = ? AND until BETWEEN ? AND ? RETURNING name",
                (_hash_token(token), now, now + _LATEST_END_S),
            ).fetchone()
            if row is None:
                raise WrongSecretError(
                    "the enrolment", "Let an administrator run `cellcal people enrol-device` again."
                )
            device = EnrolledDevice(secrets.token_hex(8), row[0], key, self._clock())
            at.execute(
                "INSERT INTO device VALUES (?, ?, ?, ?, NULL)",
                (device.id, device.name, device.key, device.enrolled_at),
            )
        return device

    def list_devices(self) -> tuple[EnrolledDevice, ...]:
        """Return every device that may be used, oldest first."""
        rows = self._query_rows(
            "SELECT id, name, key, enrolled_at FROM device WHERE revoked_at IS NULL ORDER BY enrolled_at"
        )
        return tuple(EnrolledDevice(*row) for row in rows)

    def find_device(self, device_id: str) -> EnrolledDevice | None:
        """Return one device, None when it is unknown or revoked."""
        return next((each for each in self.list_devices() if each.id == device_id), None)

    def revoke_device(self, device_id: str, by: str) -> EnrolledDevice:
        """Let a device in no longer; its sessions end at once."""
        device = self.find_device(device_id)
        if device is None:
            raise PeopleError(
                make_message("there is no device {device_id!r}.", device_id=device_id),
                remedy="`cellcal people list` names them.",
            )
        with self._write_transaction(by, f"revoke device {device.id} {device.name}") as at:
            at.execute("UPDATE device SET revoked_at = ? WHERE id = ?", (self._clock(), device.id))
        return device

    # guesses

    def note_guess(self, name: str, device_id: str) -> int:
        """Note a guess as failed before it is looked at, so that many at once gain nothing; return its number.

        Raises
        ------
        TooManyGuessesError
            The person, the device or the whole station has used up what is allowed.
        """
        now = self._guess_clock()
        with self._write_transaction(None, "") as at:
            at.execute("DELETE FROM failure WHERE at < ?", (now - DAY_S,))
            at.execute("UPDATE failure SET at = ? WHERE at > ?", (now, now))  # it was ahead before a restart
            rows = at.execute("SELECT at, person, device, cleared FROM failure ORDER BY at, id").fetchall()
            mine = [row for row in rows if row[1] == fold_name(name)]
            here = [row for row in rows if row[2] == device_id]
            wait = max(
                wait_s([row[0] for row in mine], sum(not row[3] for row in mine), PERSON, now),
                wait_s([row[0] for row in here], len(here), DEVICE, now),
                wait_s([row[0] for row in rows], len(rows), STATION, now),
            )
            if wait > 0.0:
                raise TooManyGuessesError(wait)
            noted = at.execute(
                "INSERT INTO failure (at, person, device) VALUES (?, ?, ?)", (now, fold_name(name), device_id)
            )
            return int(noted.lastrowid or 0)

    def guessed_right(self, guess: int, name: str) -> None:
        """Take a guess back, and let the person begin to count anew."""
        with self._write_transaction(None, "") as at:
            at.execute("DELETE FROM failure WHERE id = ?", (guess,))
            at.execute("UPDATE failure SET cleared = 1 WHERE person = ?", (fold_name(name),))

    # the log

    def log_event(self, who: str, what: str) -> None:
        """Log what happened at a sign-in."""
        with self._write_transaction(who, what):
            pass

    def list_events(self) -> tuple[tuple[float, str, str], ...]:
        """Return what was changed and who came in: time, by whom, what; oldest first."""
        return tuple(self._query_rows("SELECT at, who, what FROM event ORDER BY rowid"))

    # the file

    def _query_rows(self, query: str) -> list[Any]:
        if not self.path.exists():
            return []
        with self._open_database() as database:
            return database.execute(query).fetchall()

    @contextmanager
    def _write_transaction(self, who: str | None, what: str) -> Iterator[sqlite3.Connection]:
        with self._open_database() as database:
            database.execute("BEGIN IMMEDIATE")
            try:
                yield database
                if who is not None:
                    database.execute("INSERT INTO event VALUES (?, ?, ?)", (self._clock(), who, what))
                database.execute("COMMIT")
            except BaseException:
                database.execute("ROLLBACK")
                raise

    @contextmanager
    def _open_database(self) -> Iterator[sqlite3.Connection]:
        try:
            if not self.path.exists():
                make_private_folder(self.path.parent)
                os.close(os.open(self.path, os.O_CREAT | os.O_RDWR, 0o600))
            with closing(sqlite3.connect(self.path, timeout=_BUSY_S, isolation_level=None)) as database:
                database.execute("PRAGMA synchronous = FULL")
                self._create_tables(database)
                yield database
        except (OSError, sqlite3.Error) as error:
            raise PeopleError(
                make_message(
                    "the register of people {path} cannot be used: {error}.", path=self.path, error=error
                ),
                remedy=_cure_of(error),
            ) from error

    def _create_tables(self, database: sqlite3.Connection) -> None:
        if _schema_version(database) == _VERSION:
            return
        database.execute("BEGIN IMMEDIATE")
        if _schema_version(database) == 0:
            for statement in _TABLES.split(";\n"):
                database.execute(statement)
            database.execute(f"PRAGMA user_version = {_VERSION}")
        database.execute("COMMIT")
        if _schema_version(database) != _VERSION:
            raise PeopleError(
                make_message("{path} was written by another version of cellcal.", path=self.path),
                remedy="Use that version.",
            )


def _cure_of(error: OSError | sqlite3.Error) -> str:
    """Return what helps: a register on a full or read-only disk is whole, and needs no backup."""
    number = error.errno if isinstance(error, OSError) else _SYSTEM_NUMBERS.get(primary_code(error))
    if number is None:
        return "Restore it from a backup, and let the user who runs cellcal read and write it."
    return explain_os_error(OSError(number, ""))[1]


def _schema_version(database: sqlite3.Connection) -> int:
    return int(database.execute("PRAGMA user_version").fetchone()[0])


def _hash_token(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
