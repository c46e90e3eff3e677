"""Which screen has control of the session: one screen orders, the others look on and may ask to take over.

A stop needs no control, and letting the hold button go needs none. Control is free until the first order, and again
when its holder signs out, is locked out by idling, or may no longer run anything. A request that the holder leaves
unanswered for half a minute is granted when the page that made it asks again: one that left meanwhile gets nothing.
A holder without an open page answers nothing: then it takes a few seconds, which a page that is reloaded needs.
Who has control on another screen already goes on at this one at once: nobody else is asked.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from cellcal.service.people.errors import ElsewhereError

REQUEST_GRANTED_S = 30.0
HOLDER_GONE_GRANTED_S = 5.0  # where no page of the holder is open
_REQUEST_VALID_S = 15.0  # beyond that the request has expired


@dataclass(frozen=True, slots=True)
class SessionHolder:
    """A signed-in browser. ``id`` is that of its session, never its token."""

    id: str
    name: str


@dataclass
class SessionControl:
    """The seat in control, and the one that asks for it. ``has_open_page``: a seat still looks on."""

    clock: Callable[[], float] = time.monotonic
    has_open_page: Callable[[str], bool] = lambda _: True
    asked_s: float = REQUEST_GRANTED_S
    _holder: SessionHolder | None = field(init=False, default=None)
    _asking: tuple[SessionHolder, float] | None = field(init=False, default=None)  # and since when

    def drop_inactive(self, is_in_charge: Callable[[str], bool]) -> None:
        """Forget a holder without the right to order, and a requester that has left."""
        if self._holder is not None and not is_in_charge(self._holder.id):
            self._holder = None
        if self._asking is not None:
            session_id, since_s = self._asking
            if self.clock() - since_s > self.asked_s + _REQUEST_VALID_S or not is_in_charge(session_id.id):
                self._asking = None

    @property
    def current_holder(self) -> SessionHolder | None:
        """Who has control, None while it is free."""
        return self._holder

    @property
    def takeover_requester(self) -> SessionHolder | None:
        """Who requests to take over, None without a request."""
        return None if self._asking is None else self._asking[0]

    def take_control(self, holder: SessionHolder) -> None:
        """Let a seat order: it has control, or takes it where it is free.

        Raises
        ------
        ElsewhereError
            Another seat has it.
        """
        if self._holder is not None and self._holder.id != holder.id:
            raise ElsewhereError(self._holder.name)
        self._holder = holder

    def request_control(self, holder: SessionHolder) -> None:
        """Ask to take over: given at once to the holder's other screen, to another person after half a minute.

        Raises
        ------
        ElsewhereError
            A third seat is asking already.
        """
        if self._holder is None or self._holder.id == holder.id:
            self._holder, self._asking = holder, None
        elif self._holder.name == holder.name:
            self._holder = holder  # who asks meanwhile is answered there
        elif self._asking is None:
            self._asking = (holder, self.clock())
        elif self._asking[0].id != holder.id:
            raise ElsewhereError(self._asking[0].name)
        elif self._remaining_s() <= 0.0:
            self._holder, self._asking = holder, None

    def withdraw_request(self, session_id: str) -> None:
        """Ask no longer."""
        if self._asking is not None and self._asking[0].id == session_id:
            self._asking = None

    def answer_request(self, session_id: str, *, give: bool) -> None:
        """Hand control over to the requester, or refuse; only the holder can."""
        if self._holder is None or self._holder.id != session_id or self._asking is None:
            return
        if give:
            self._holder = self._asking[0]
        self._asking = None

    def release_control(self, session_id: str) -> None:
        """Give control up, and ask no longer."""
        self.withdraw_request(session_id)
        if self._holder is not None and self._holder.id == session_id:
            self._holder = None

    def to_json(self, session_id: str) -> dict[str, object]:
        """Return it as the screen of one seat shows it."""
        asking = self.takeover_requester
        return {
            "mine": self._holder is not None and self._holder.id == session_id,
            "holder": None if self._holder is None else self._holder.name,
            "asking": None if asking is None else asking.name,
            "asking_mine": asking is not None and asking.id == session_id,
            "remaining_s": None if asking is None else max(self._remaining_s(), 0.0),
        }

    def _remaining_s(self) -> float:
        assert self._asking is not None
        is_gone = self._holder is not None and not self.has_open_page(self._holder.id)
        granted_s = min(self.asked_s, HOLDER_GONE_GRANTED_S) if is_gone else self.asked_s
        return self._asking[1] + granted_s - self.clock()
