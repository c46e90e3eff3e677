"""Authentication: from a token, a device's signature or a PIN to a session, and from a session to a person."""

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from cellcal.service.people.accounts import Account, AccountStore, EnrolledDevice
from cellcal.service.people.device_keys import Challenges, is_signed, public_key_of, signed_text
from cellcal.service.people.errors import NotSignedInError, WrongSecretError
from cellcal.service.people.naming import LOCAL
from cellcal.service.people.pin_hashing import PinHasher, pepper_of
from cellcal.service.people.roles import RIGHTS, OrderNeed, Right, Role
from cellcal.service.people.secret_check import verify_secret
from cellcal.service.people.sessions import CONSOLE, Session, SessionStore
from cellcal.service.times import steady_time


@dataclass(frozen=True, slots=True)
class Person:
    """The person at a screen.

    ``role`` counts at this moment: after the screen was left alone it is viewer until the PIN is entered.
    ``alone``: no person is set up, and this computer's console acts as the technician without a PIN.
    """

    name: str
    role: Role
    locked: bool = False
    fresh_pin: bool = False
    alone: bool = False
    session_id: str = ""  # of the session; none where no sign-in is required

    def has_right(self, right: Right) -> bool:
        """Whether it is allowed."""
        return self.alone or right in RIGHTS[self.role]

    def may_by_itself(self, need: OrderNeed) -> bool:
        """Whether what an order takes is there without another person."""
        return self.has_right(need.right) and (not need.writes or self.has_right(Right.WRITE_ALONE))


LOCAL_PERSON = Person(LOCAL, Role.TECHNICIAN, fresh_pin=True, alone=True)


@dataclass
class Authenticator:
    """Authentication of web requests. ``open_access`` makes each the local technician's: for demos on loopback."""

    data_dir: Path
    open_access: bool = False
    clock: Callable[[], float] = (
        steady_time  # of sessions and challenges; it goes on while the computer sleeps
    )
    wall_clock: Callable[[], float] | None = None  # of what is kept; None: the time of day
    make_hasher: Callable[[bytes], PinHasher] = PinHasher
    on_console_token: Callable[[str], None] | None = None
    accounts: AccountStore = field(init=False)
    sessions: SessionStore = field(init=False)
    _console: str | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.accounts = AccountStore(self.data_dir, self.wall_clock)
        self.sessions = SessionStore(self.clock)
        self._challenges = Challenges(self.clock)
        self._hashing = threading.Lock()  # one at a time: each takes 64 MiB and four threads

    # who is there

    def authenticate(self, token: str | None) -> Person:
        """Return who has this session.

        Raises
        ------
        NotSignedInError
            There is no such session, or its device was revoked.
        """
        session = self._find_session(token)
        if session is None:
            if self.open_access:
                return LOCAL_PERSON
            raise NotSignedInError
        return replace(self._person_of(session), session_id=session.session_id)

    def is_in_charge(self, session_id: str) -> bool:
        """Whether the signed-in person may run procedures at present."""
        session = self.sessions.session_at(session_id)
        return session is not None and self._person_of(session).has_right(Right.RUN)

    def _person_of(self, session: Session) -> Person:
        people = self.accounts.list_people()
        if session.person is None:
            if session.device == CONSOLE and (self.open_access or not people):
                return LOCAL_PERSON
            return Person(self._device_name(session), Role.VIEWER)
        account = next((each for each in people if each.name == session.person), None)
        if account is None or account.epoch != session.epoch or not self._is_enrolled(session):
            return Person(self._device_name(session), Role.VIEWER)
        if self.sessions.is_locked(session):
            return Person(account.name, Role.VIEWER, locked=True)
        return Person(account.name, account.role, fresh_pin=self.sessions.is_fresh(session))

    def note_activity(self, token: str | None) -> None:
        """Note activity of this session."""
        session = self._find_session(token)
        if session is not None:
            self.sessions.note_use(session)

    def _find_session(self, token: str | None) -> Session | None:
        session = self.sessions.find_session(token)
        if session is None or self._is_enrolled(session):
            return session
        assert token is not None
        self.sessions.end_session(token)
        return None

    def _is_enrolled(self, session: Session) -> bool:
        return session.device == CONSOLE or self.accounts.find_device(session.device) is not None

    def _device_name(self, session: Session) -> str:
        device = self.accounts.find_device(session.device)
        return CONSOLE if device is None else device.name

    def open_local_session(self, token: str | None) -> str | None:
        """Give a browser that is let in unasked a seat of its own; return its new token, None where it needs none."""
        if not self.open_access or self._find_session(token) is not None:
            return None
        return self.sessions.open_session(CONSOLE)

    # this computer's console

    def console_token(self) -> str:
        """Return a token that opens one session at this computer; the one before it is void."""
        self._console = secrets.token_urlsafe(32)
        return self._console

    def from_console(self, token: str) -> str:
        """Use the console's token up and return a session's.

        Raises
        ------
        WrongSecretError
            It is not the token, or it was used.
        """
        good = self._console is not None and secrets.compare_digest(token.encode(), self._console.encode())
        if not good:
            raise WrongSecretError("the address", "Use the newest address that `cellcal serve` printed.")
        self._console = None
        if self.on_console_token is not None:
            self.on_console_token(self.console_token())
        return self.sessions.open_session(CONSOLE)

    # enrolled devices

    def enrol_device(self, token: str, spki: str) -> EnrolledDevice:
        """Enrol a browser with its public key (SPKI, base64url) and a token of ten minutes."""
        return self.accounts.enrol_device(token, public_key_of(spki))

    def create_challenge(self) -> str:
        """Return what a device has to sign."""
        return self._challenges.create_challenge()

    def from_device(self, device_id: str, challenge: str, signature: str, origin: str) -> str:
        """Return a session's token to a device that proved its key.

        Raises
        ------
        WrongSecretError
            It did not: unknown, revoked, too late, or another key.
        """
        in_time, device = self._challenges.use_challenge(challenge), self.accounts.find_device(device_id)
        if (
            not in_time
            or device is None
            or not is_signed(device.key, signature, signed_text(origin, challenge))
        ):
            raise WrongSecretError("this device's proof", "Let an administrator enrol the device again.")
        return self.sessions.open_session(device.id)

    # people

    def sign_in(self, token: str | None, name: str, secret: str) -> str:
        """Let a person in on a device's session; return the new token. Takes a fifth of a second; call in a thread.

        Raises
        ------
        NotSignedInError
            The device has no session.
        WrongSecretError, TooManyGuessesError
            The name or the PIN is wrong, or may not be guessed just now.
        """
        session = self._find_session(token)
        if token is None or session is None:
            raise NotSignedInError
        account = self._verify_secret(session, name, secret)
        if self.sessions.find_session(token) is not session:
            raise NotSignedInError  # it ended meanwhile
        self.accounts.log_event(account.name, f"signed in at {self._device_name(session)}")
        return self.sessions.sign_person_in(token, account.name, account.epoch)

    def confirm_pin(self, token: str | None, secret: str) -> None:
        """Check the PIN of the session's person once more: it unlocks, and counts for an approval."""
        session = self._find_session(token)
        if session is None or session.person is None:
            raise NotSignedInError
        account = self._verify_secret(session, session.person, secret)
        if account.epoch != session.epoch:
            raise NotSignedInError
        self.sessions.confirm_pin(session)

    def verify_second_person(self, token: str | None, name: str, secret: str) -> Person:
        """Return a second person, who enters name and PIN at another's screen for one approval; call in a thread.

        Raises
        ------
        NotSignedInError, WrongSecretError, TooManyGuessesError
            As `sign_in` does.
        """
        session = self._find_session(token)
        if session is None:
            raise NotSignedInError
        account = self._verify_secret(session, name, secret)
        self.accounts.log_event(account.name, f"gave the PIN for an approval at {self._device_name(session)}")
        return Person(account.name, account.role, fresh_pin=True, session_id=session.session_id)

    def sign_out(self, token: str | None) -> str:
        """Let the person go; the device looks on."""
        if token is None or self._find_session(token) is None:
            raise NotSignedInError
        return self.sessions.sign_person_out(token)

    def _verify_secret(self, session: Session, name: str, secret: str) -> Account:
        return verify_secret(
            self.accounts,
            lambda: self.make_hasher(pepper_of(self.data_dir)),
            name,
            secret,
            session.device,
            self._hashing,
        )
