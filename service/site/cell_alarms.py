"""Which alarms are up in a cell: by its cell process, by its journal, by what is due."""

from collections.abc import Iterable
from datetime import UTC, datetime

from cellcal.calibration.message import make_message
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.site.alarms import AlarmSet, CellAlarm, list_alarms
from cellcal.service.site.cell_state import DueDates, overdue_items
from cellcal.service.site.controller_tap import ControllerTap

CONTROLLER_STARTS_S = 30.0
_NOT_OF_CONTROLLER = ("due", "journal", "desk.silent")


class CellAlarmWatch:
    """Looks again and again. ``initial`` were up at the last look; ``awaits_cell_process``: there must be one."""

    def __init__(
        self, config: CellConfig, tap: ControllerTap, due: DueDates, *,
        initial: Iterable[CellAlarm] = (), now_s: float = 0.0, awaits_cell_process: bool = False,
    ) -> None:  # fmt: skip
        self._config, self._tap, self._due = config, tap, due
        self._alarms = AlarmSet(initial, now_s)
        self._cell_process_due_s = now_s + CONTROLLER_STARTS_S if awaits_cell_process else float("inf")

    @property
    def active_alarms(self) -> list[CellAlarm]:
        """Every alarm that is up."""
        return self._alarms.active_alarms

    def update_alarms(self, now_s: float, journal_trouble: str = "") -> list[tuple[CellAlarm, bool]]:
        """Return what was raised (True) or cleared (False) since the last look."""
        return self._alarms.update_alarms(
            [*self._controller_alarms(now_s), *self._local_alarms(now_s, journal_trouble)], now_s
        )

    def _controller_alarms(self, now_s: float) -> list[CellAlarm]:
        session = self._tap.latest_session()
        if session is not None:
            self._cell_process_due_s = now_s  # from here on it must be heard
            return list_alarms(session, self._tap.latest_live())
        current = [alarm for alarm in self._alarms.active_alarms if alarm.code not in _NOT_OF_CONTROLLER]
        if now_s < self._cell_process_due_s:
            return current  # who heard nothing yet must not say that all is well
        name = self._config.cell.name
        silent = CellAlarm(
            "desk.silent", name, "nothing is heard of its cell process", "Look at its service."
        )
        return [*current, silent]

    def _local_alarms(self, now_s: float, journal_trouble: str) -> list[CellAlarm]:
        late = [
            CellAlarm(
                "due", item["what"], make_message("was due on {item}", item=item["due"]), "Have it done."
            )
            for item in overdue_items(self._due.due_items(now_s), datetime.now(UTC).date())
        ]
        broken = [CellAlarm("journal", self._config.cell.name, journal_trouble)] * bool(journal_trouble)
        return late + broken
