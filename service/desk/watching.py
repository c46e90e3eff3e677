"""The desk's eye on the encoders: what `cellcal watch` sees, shown on every screen."""

from typing import Any, cast

from drivers.errors import DeviceError
from procedures.cell import Cell
from service.configuration.cell_file import CellConfig
from service.watching.answers_to_loss import PreparedAnswer, journal_detection, prepare_answer
from service.watching.held_mastering import HeldMastering, journalled_mastering
from service.watching.watch import LastHealthyCounts, PositionLoss, Watch, WatchedRobot


class DeskWatch:
    """Looks every period while no run has the robot; keeps what was lost until a run has mended it."""

    def __init__(self, config: CellConfig, changed: Any) -> None:
        self._config, self._changed = config, changed
        self._watch: Watch | None = None
        self._cell: Cell | None = None
        self._next_s = 0.0
        self._losses: dict[str, tuple[PositionLoss, PreparedAnswer]] = {}

    async def look(self, cell: Cell, *, now_s: float, busy: bool) -> None:
        """Look once if it is time."""
        if cell.mastering is None or now_s < self._next_s:
            return
        self._next_s = now_s + self._config.watch.period_s
        if cell is not self._cell:
            self._cell, self._watch = cell, self._new_watch(cell)
        assert self._watch is not None
        if busy:
            self._watch.forget_motion()
            return
        try:
            condition = await cell.robot.condition()
            await self._watch.look()
        except DeviceError:
            return
        mended = not condition.alarms and not self._watch.standing
        if mended and cell.robot.name in self._losses and await self._is_mastered(cell):
            del self._losses[cell.robot.name]
            self._changed()

    def as_json(self) -> list[dict[str, Any]]:
        """Return what was lost, and what is prepared for it."""
        return [
            {
                "robot": loss.robot,
                "what": loss.suspicion.what.value,
                "detected_by": loss.detected_by,
                "mode": loss.suspicion.mode.value,
                "words": loss.suspicion.words,
                "procedure": answer.procedure,
                "settings": answer.settings,
                "reasons": list(answer.reasons),
            }
            for loss, answer in self._losses.values()
        ]

    def starts_alone(self, robot: str) -> PreparedAnswer | None:
        """Return the answer that the cell file lets the service start by itself."""
        found = self._losses.get(robot)
        return found[1] if found is not None and found[1].starts_alone else None

    def _new_watch(self, cell: Cell) -> Watch:
        memory = LastHealthyCounts(self._config.cell.data_dir)
        robot = cast(WatchedRobot, cell.robot)
        held = HeldMastering(journalled_mastering(self._config, self._config.robot(cell.robot.name).serial))
        return Watch(robot, memory, self._on_loss, period_s=self._config.watch.period_s, held=held)

    async def _on_loss(self, loss: PositionLoss) -> None:
        journal_detection(self._config, loss)
        self._losses[loss.robot] = (loss, prepare_answer(self._config, loss))
        self._changed()

    async def _is_mastered(self, cell: Cell) -> bool:
        assert cell.mastering is not None
        return (await cell.mastering.mastering()).mastered
