"""Sessions of people at devices, in this process only, so that a restart asks all of them to sign in again.

A session begins with a device (enrolled, or this computer's console) and may get a person. Left alone for five
minutes it is locked: it still shows and still stops; the PIN opens it again. After twelve hours it is over.
"""

import hashlib
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field

IDLE_S = 300.0
WHOLE_S = 12 * 3600.0
FRESH_S = 120.0  # how long an entered PIN counts for an approval
CONSOLE = "console"
_MOST = 1000


@dataclass(slots=True)
class Session:
    """One browser. ``epoch`` is that of the person's entry when the PIN was entered."""

    device: str
    opened_s: float
    used_s: float
    person: str | None = None
    epoch: int = 0
    confirmed_s: float = float("-inf")
    session_id: str = field(default_factory=lambda: secrets.token_hex(8))  # names it to others; opens nothing


class SessionStore:
    """All sessions, found by the hash of their 256-bit token."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._open: dict[str, Session] = {}

    def __len__(self) -> int:
        """Return how many are kept."""
        return len(self._open)

    def open_session(self, device: str) -> str:
        """Open a session without a person and return its token."""
        now = self._clock()
        return self._store_session(Session(device, now, now))

    def find_session(self, token: str | None) -> Session | None:
        """Return the session of a token, None when it is unknown or over."""
        if not token:
            return None
        key = _hash_token(token)
        session = self._open.get(key)
        if session is not None and self._clock() - session.opened_s > WHOLE_S:
            del self._open[key]
            return None
        return session

    def session_at(self, session_id: str) -> Session | None:
        """Return the session of a seat, None when it is over."""
        now = self._clock()
        found = (each for each in self._open.values() if each.session_id == session_id)
        return next((each for each in found if now - each.opened_s <= WHOLE_S), None)

    def sign_person_in(self, token: str, person: str, epoch: int) -> str:
        """Let a person in after the PIN; the token changes, so that one known before is worth nothing."""
        now = self._clock()
        device = self._open.pop(_hash_token(token)).device
        return self._store_session(Session(device, now, now, person, epoch, now))

    def sign_person_out(self, token: str) -> str:
        """Let the person go; the device goes on looking on, under a new token and until its old end."""
        old = self._open.pop(_hash_token(token))
        return self._store_session(Session(old.device, old.opened_s, self._clock()))

    def end_session(self, token: str) -> None:
        """Forget a session."""
        self._open.pop(_hash_token(token), None)

    def note_use(self, session: Session) -> None:
        """Note that a person does something. What is locked stays locked."""
        if not self.is_locked(session):
            session.used_s = self._clock()

    def is_locked(self, session: Session) -> bool:
        """Whether the session was idle for five minutes."""
        return self._clock() - session.used_s > IDLE_S

    def is_fresh(self, session: Session) -> bool:
        """Whether the PIN was entered just now."""
        return self._clock() - session.confirmed_s <= FRESH_S

    def confirm_pin(self, session: Session) -> None:
        """Note that the PIN was entered again."""
        session.used_s = session.confirmed_s = self._clock()

    def _store_session(self, session: Session) -> str:
        while len(self._open) >= _MOST:
            self._open.pop(next(iter(self._open)))
        token = secrets.token_urlsafe(32)
        self._open[_hash_token(token)] = session
        return token


def _hash_token(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
