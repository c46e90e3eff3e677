"""Events that a monitor has not opened: bounded for each cell, and no cell waits behind another's flood."""

from dataclasses import dataclass

from cellcal.service.site.event_inbox import MOST_BYTES, MOST_BYTES_OF_ALL, MOST_EVENTS, EventInbox


def _event_key(cell: str) -> str:
    return f"cellcal/v1/hall-3/{cell}/session/run-1/event"


@dataclass
class _Payload:
    raw: bytes

    def to_bytes(self) -> bytes:
        return self.raw


@dataclass
class _Sample:
    key_expr: str
    payload: _Payload


class _Source:
    def __init__(self, cell: str, count: int) -> None:
        self._samples = [_Sample(_event_key(cell), _Payload(b"%d" % number)) for number in range(count)]

    def try_recv(self) -> _Sample | None:
        return self._samples.pop(0) if self._samples else None


def test_a_flood_of_one_cell_is_bounded_named_once_and_delays_no_other_cell() -> None:
    inbox = EventInbox(["loud", "calm"])
    assert inbox.receive([_Source("loud", MOST_EVENTS + 50)]) == ("loud",)
    assert inbox.receive([_Source("loud", 50), _Source("calm", 3), _Source("stranger", 9)]) == ()
    first = inbox.take(6)
    assert [raw for key, raw in first if key == _event_key("calm")] == [b"0", b"1", b"2"]
    assert [raw for key, raw in first if key == _event_key("loud")] == [b"0", b"1", b"2"]
    assert len(inbox.take(10 * MOST_EVENTS)) == MOST_EVENTS - 3
    assert inbox.take(5) == []


def test_long_events_are_bounded_by_their_bytes_in_a_cell_and_in_all() -> None:
    cells = [f"c{number}" for number in range(2 * MOST_BYTES_OF_ALL // MOST_BYTES)]
    inbox, piece = EventInbox(cells), bytes(MOST_BYTES // 4)
    for _ in range(6):
        for cell in cells:
            inbox.add(_event_key(cell), piece)
    waiting = inbox.take(10_000)
    assert sum(len(raw) for _, raw in waiting) <= MOST_BYTES_OF_ALL
    assert {key for key, _ in waiting} == {_event_key(cell) for cell in cells}
