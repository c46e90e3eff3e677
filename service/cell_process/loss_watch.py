"""Watches the encoders: what `cellcal watch` detects, shown on every screen; and what may start alone."""

from collections.abc import Callable
from dataclasses import replace

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, WireProtocolError
from cellcal.drivers.supervision import SUPERVISOR
from cellcal.procedures.cell import Cell
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.session_documents import LossDocument
from cellcal.service.watching.follow import RobotWatches
from cellcal.service.watching.loss_response import PreparedAnswer, answer_to
from cellcal.service.watching.watch import PositionLoss
from cellcal.service.watching.watch_coverage import sees_losses


class LossWatch:
    """Looks every period while no run has the robot; keeps what was lost until a run has mended it.

    ``occupied`` tells in words why nothing may be started alone on a robot just now; empty where nothing hinders.
    """

    def __init__(
        self, config: CellConfig, changed: Callable[[str], None], occupied: Callable[[str], str]
    ) -> None:
        self._config, self._changed, self._occupied = config, changed, occupied
        self.watches = RobotWatches(config, self._on_loss)
        self._next_s = 0.0
        self._losses: dict[str, tuple[PositionLoss, PreparedAnswer]] = {}
        self._allowed: PreparedAnswer | None = None

    async def check_robot(self, cell: Cell, *, now_s: float, busy: bool) -> PreparedAnswer | None:
        """Look once if it is time; return the answer to a loss that it found, where that may be started alone."""
        is_watched = sees_losses(cell.robot.capabilities)
        if is_watched and busy:
            self.watches.watch_of(cell.robot.name, cell.robot).forget_motion()
            self._next_s = now_s  # a run that has mended a loss takes it off the screens at its end
            return None
        if now_s < self._next_s:
            return None
        self._next_s = now_s + self._config.watch.period_s
        if not is_watched:
            await self.clear_resolved_loss(cell.robot.name)
            return None
        watch = self.watches.watch_of(cell.robot.name, cell.robot)
        self._allowed = None
        try:
            await watch.look_once()
            await self.clear_resolved_loss(cell.robot.name)
        except (
            WireProtocolError
        ) as error:  # readings that contradict each other: no session shows that otherwise
            SUPERVISOR.note_failure(
                make_message("watch of {robot}", robot=cell.robot.name), error, running=True
            )
            return None
        except DeviceError:
            return None
        return self._allowed

    async def look_before_resuming(self, cell: Cell, *, now_s: float) -> None:
        """Look once before a run goes on that a killed process has left: it had the robot, and no look follows."""
        if sees_losses(cell.robot.capabilities):
            self.watches.watch_of(cell.robot.name, cell.robot).forget_motion()
            await self.check_robot(cell, now_s=now_s, busy=False)

    async def clear_resolved_loss(self, robot: str) -> None:
        """Take a loss off the screens where a robot that was just looked at has none any more."""
        if robot not in self._losses:
            return
        watch = self.watches.existing_watch(robot)
        if watch is None or await watch.is_resolved():
            del self._losses[robot]
            self._changed(robot)

    def as_json(self) -> list[LossDocument]:
        """Return what was lost, and what is prepared for it."""
        return [
            {
                "robot": loss.robot,
                "what": loss.suspicion.loss_kind.value,
                "detected_by": loss.detected_by,
                "mode": loss.suspicion.mode.value,
                "words": loss.suspicion.words,
                "procedure": answer.procedure,
                "settings": answer.settings,
                "reasons": list(answer.reasons),
                "alone_wanted": self._config.watch.recover_alone,
            }
            for loss, answer in self._losses.values()
        ]

    async def _on_loss(self, loss: PositionLoss) -> None:
        answer, _ = answer_to(self._config, loss)
        occupied = self._occupied(loss.robot)
        if occupied:
            answer = replace(answer, reasons=(*answer.reasons, occupied))
        if answer.starts_unattended:
            self._allowed = answer
        self._losses[loss.robot] = (loss, answer)
        self._changed(loss.robot)
