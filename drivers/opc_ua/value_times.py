"""The times that a server gives with its positions, by which a value that no longer comes from the arm is known.

OPC 10000-4 (7.11, DataValue): a source timestamp is given by the source of a value, and never changes for that value.
Some servers stamp each sample, others each change: a time that stands still says something only of the first kind.
"""

from dataclasses import dataclass
from datetime import UTC, datetime

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError

OLDEST_S = 5.0  # of a sample, where the server stamps each of them
_LOOK = "Look at the controller and its OPC UA server: the positions may no longer come from the arm."


@dataclass(frozen=True, slots=True)
class _Stamped:
    """The last value of an axis with its time, and when that time was new to us."""

    value: float
    stamp: datetime
    new_at_s: float
    is_sampled: bool  # the time went on while the value stood still


class ValueTimes:
    """The newest times of all axes in one session."""

    def __init__(self) -> None:
        self._axes: dict[str, _Stamped] = {}

    def forget(self) -> None:
        """Begin anew, as in a new session."""
        self._axes.clear()

    def take_value(self, device: str, axis: str, value: float, stamp: datetime | None, now_s: float) -> None:
        """Take a value with its time.

        Raises
        ------
        RefusedError
            It is older than one that was read before, or its time stands still where each sample had its own.
        """
        last = self._axes.get(axis)
        if stamp is None:
            self._axes.pop(axis, None)
            return
        stamp = as_utc(stamp)
        if last is None or stamp > last.stamp:
            is_sampled = last is not None and (last.is_sampled or value == last.value)
            self._axes[axis] = _Stamped(value, stamp, now_s, is_sampled)
            return
        age_s = now_s - last.new_at_s
        if stamp < last.stamp:
            self.forget()  # the clock may have been set: what follows is compared with this
            text = make_message(
                "the OPC UA server gives a position of {axis} that is older than one before.", axis=axis
            )
        elif last.is_sampled and age_s > OLDEST_S:
            text = make_message(
                "the OPC UA server gives a position of {axis} whose time has stood still for {age_s:.0f} s.",
                axis=axis,
                age_s=age_s,
            )
        else:
            return
        raise RefusedError(device, text, remedy=_LOOK)


def describe_age(stamps: list[datetime | None], clock: datetime | None) -> str:
    """Return in a sentence what the times of the positions leave open; "" where they are those of now."""
    known = [as_utc(stamp) for stamp in stamps if stamp is not None]
    if len(known) < len(stamps):
        return (
            "The server gives no time with its positions: whether they still come from the arm cannot be told. Jog "
            "each axis once and see that its value follows."
        )
    if clock is None:
        return ""
    age_s = (as_utc(clock) - min(known)).total_seconds()
    if age_s <= OLDEST_S:
        return ""
    return make_message(
        "The positions bear a time {age_s:.0f} s before the server's clock: the arm has stood since then, or they no "
        "longer come from it. Jog each axis once and see that its value follows.",
        age_s=age_s,
    )


def as_utc(stamp: datetime) -> datetime:
    """Return a time with its zone; the protocol knows UTC alone."""
    return stamp if stamp.tzinfo is not None else stamp.replace(tzinfo=UTC)
