"""Alarms in the controller's words and registers.

Imitates
    The active-alarm page of a FANUC controller, as ALM[1] shows it.
Source
    deploy/controller_setup/fanuc_hmi.md, assignment 19 and "Alarms that matter".
Modelled
    The alarms of that page, with axis, time, text; newest first; five places.
Not modelled
    Cause codes, histories, other languages.
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cellcal.fake_devices.modbus_robot.words import text_words

ALARM_WORDS = 100
_FACILITY = {"SRVO": 11, "MOTN": 15, "SYST": 24}
_EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
_TEXTS = {
    "SRVO-001": ("Operator panel E-stop", "SERVO"),
    "SRVO-038": ("Pulse mismatch (Group:1 Axis:{axis})", "SERVO2"),
    "SRVO-050": ("CLALM alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-062": ("BZAL alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-064": ("PHAL alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-065": ("BLAL alarm (Group:1 Axis:{axis})", "WARN"),
    "SRVO-068": ("DTERR alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-069": ("CRCERR alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-070": ("STBERR alarm (Group:1 Axis:{axis})", "SERVO"),
    "MOTN-017": ("Limit error (Group:1 Axis:{axis})", "WARN"),
    "SRVO-071": ("SPHAL alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-072": ("PMAL alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-073": ("CMAL alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-074": ("LDAL alarm (Group:1 Axis:{axis})", "SERVO"),
    "SRVO-075": ("Pulse not established (Group:1 Axis:{axis})", "WARN"),
}
_SEVERITY = {"WARN": 0, "SERVO": 4, "SERVO2": 5}
CODES = frozenset(_TEXTS)


@dataclass(frozen=True)
class ActiveAlarm:
    """One line of the alarm page."""

    code: str
    axis: int | None  # 0-based
    since_s: float  # world time

    @property
    def pendant_text(self) -> str:
        """Text as on the pendant."""
        return _TEXTS[self.code][0].format(axis="" if self.axis is None else self.axis + 1)

    def to_words(self) -> list[int]:
        """Return the 100 registers of this alarm."""
        facility, number = self.code.split("-")
        severity = _TEXTS[self.code][1]
        when = _EPOCH + timedelta(seconds=self.since_s)
        head = [_FACILITY[facility], int(number), 0, 0, _SEVERITY[severity]]
        clock = [when.year, when.month, when.day, when.hour, when.minute, when.second]
        return head + clock + text_words(self.pendant_text, 40) + text_words("", 40) + text_words(severity, 9)


def alarm_block(alarms: list[ActiveAlarm], places: int) -> list[int]:
    """Return the registers of the newest alarms; empty places are zero."""
    words: list[int] = []
    for alarm in alarms[:places]:
        words += alarm.to_words()
    return words + [0] * (places * ALARM_WORDS - len(words))
