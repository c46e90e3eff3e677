"""Which alarms are up in a cell: by what its desk says, by its journal, by what is due."""

from collections.abc import Iterable
from datetime import UTC, datetime

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.site.alarms import Alarm, Alarms, wrong_in
from cellcal.service.site.desk_tap import DeskTap
from cellcal.service.site.standing import DueDates, overdue

DESK_COMES_S = 30.0
_NOT_OF_DESK = ("due", "journal", "desk.silent")


class Troubles:
    """Looks again and again. ``known`` were up when somebody looked last; ``awaits_desk``: there must be one."""

    def __init__(
        self, config: CellConfig, tap: DeskTap, due: DueDates, *,
        known: Iterable[Alarm] = (), now_s: float = 0.0, awaits_desk: bool = False,
    ) -> None:  # fmt: skip
        self._config, self._tap, self._due = config, tap, due
        self._alarms = Alarms(known, now_s)
        self._desk_due_s = now_s + DESK_COMES_S if awaits_desk else float("inf")

    @property
    def up(self) -> list[Alarm]:
        """Every alarm that is up."""
        return self._alarms.up

    def look(self, now_s: float, journal_trouble: str = "") -> list[tuple[Alarm, bool]]:
        """Return what was raised (True) or cleared (False) since the last look."""
        return self._alarms.look([*self._of_desk(now_s), *self._own(now_s, journal_trouble)], now_s)

    def _of_desk(self, now_s: float) -> list[Alarm]:
        session = self._tap.session()
        if session is not None:
            self._desk_due_s = now_s  # from here on it must be heard
            return wrong_in(session, self._tap.live())
        told = [alarm for alarm in self._alarms.up if alarm.code not in _NOT_OF_DESK]
        if now_s < self._desk_due_s:
            return told  # who heard nothing yet must not say that all is well
        name = self._config.cell.name
        silent = Alarm("desk.silent", name, "nothing is heard of its desk", "Look at its service.")
        return [*told, silent]

    def _own(self, now_s: float, journal_trouble: str) -> list[Alarm]:
        late = [
            Alarm("due", told["what"], f"was due on {told['due']}", "Have it done.")
            for told in overdue(self._due.at(now_s), datetime.now(UTC).date())
        ]
        broken = [Alarm("journal", self._config.cell.name, journal_trouble)] * bool(journal_trouble)
        return late + broken
