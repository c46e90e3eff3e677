"""What the site must be told at once: derived from the cell process's messages, raised once and cleared once.

An alarm on the bus informs people. It is no safety function, and nothing acts on it.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass

from cellcal.calibration.message import make_message
from cellcal.service.session_documents import LiveDocument, SessionDocument

STEADY_S = 2.0  # a device that flaps is one alarm
_QUIET = ("ready", "unknown")


@dataclass(frozen=True, slots=True)
class CellAlarm:
    """One thing that is wrong."""

    code: str
    source: str
    text: str
    remedy: str = ""

    @property
    def alarm_id(self) -> str:
        """The key by which the same alarm is known again."""
        return f"{self.code}:{self.source}"

    def as_json(self) -> dict[str, object]:
        """Return it as the bus carries it."""
        return {"id": self.alarm_id, **asdict(self)}


class AlarmSet:
    """The alarms that are up."""

    def __init__(self, initial: Iterable[CellAlarm] = (), now_s: float = 0.0) -> None:
        self._up = {alarm.alarm_id: (alarm, now_s) for alarm in initial}  # with when it was last true

    @property
    def active_alarms(self) -> list[CellAlarm]:
        """Every alarm that is up."""
        return [alarm for alarm, _ in self._up.values()]

    def update_alarms(self, wrong: Iterable[CellAlarm], now_s: float) -> list[tuple[CellAlarm, bool]]:
        """Take in all that is wrong now; return what was raised (True) or cleared (False) by it."""
        changes = []
        for alarm in wrong:
            if alarm.alarm_id not in self._up:
                changes.append((alarm, True))
            self._up[alarm.alarm_id] = (alarm, now_s)
        for name, (alarm, true_at_s) in list(self._up.items()):
            if now_s - true_at_s > STEADY_S:
                del self._up[name]
                changes.append((alarm, False))
        return changes


def list_alarms(session: SessionDocument | None, live: LiveDocument | None) -> list[CellAlarm]:
    """Return what is wrong by the cell process's session and live values; nothing while there is no such process."""
    if session is None:
        return []
    found = []
    connection = session["connection"]
    if not connection["connected"] and connection["message"] not in ("", "connecting"):
        found.append(
            CellAlarm("cell.unreachable", session["cell"], connection["message"], connection["remedy"])
        )
    found += [
        CellAlarm(
            f"position.{loss['what']}",
            loss["robot"],
            make_message(
                "{detection}; {description}", detection=loss["detected_by"], description=loss["words"]
            ),
        )
        for loss in session.get("losses", [])
    ]
    run = session.get("run")
    outcome = None if run is None else run.get("outcome")
    if run is not None and outcome is not None and outcome["verdict"] in ("broken", "cell_failed"):
        found.append(CellAlarm("run.broken", run["procedure"], outcome["reason"], outcome.get("remedy", "")))
    devices = [] if live is None else live.get("devices", [])
    return found + [
        CellAlarm(f"device.{device['state']}", device["name"], device["message"], device["remedy"])
        for device in devices
        if device["state"] not in _QUIET
    ]
