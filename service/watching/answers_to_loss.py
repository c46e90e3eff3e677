"""What is done about a loss: journalled, prepared, and started alone only where the cell file allows it."""

from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from pydantic_core import to_jsonable_python

from procedures.cell import MotionLevel
from procedures.past import Kind
from service.configuration.cell_file import CellConfig
from service.runs.cell import open_journal
from service.runs.store import stored_body
from service.watching.watch import PositionLoss

DETECTION = "loss_detection"


@dataclass(frozen=True, slots=True)
class PreparedAnswer:
    """The procedure that answers a loss, the command to type, and why it is not started alone (empty: it is)."""

    procedure: str | None
    settings: dict[str, Any]
    command: str
    reasons: tuple[str, ...]

    @property
    def starts_alone(self) -> bool:
        """Whether the service may start it by itself."""
        return self.procedure is not None and not self.reasons


def prepare_answer(config: CellConfig, loss: PositionLoss) -> PreparedAnswer:
    """Prepare the answer to a loss. The last healthy counts are among a recovery's settings already."""
    suspicion = loss.suspicion
    settings: dict[str, Any] = dict(suspicion.settings())
    procedure = suspicion.procedure
    told = "".join(
        f" --set {key}={value if isinstance(value, str) else list(value)}".replace(", ", ",")
        for key, value in settings.items()
    )
    command = f"cellcal run {procedure} --cell {config.path} --robot {loss.robot}{told}" if procedure else ""
    return PreparedAnswer(procedure, settings, command, tuple(_hindrances(config, loss)))


def journal_detection(config: CellConfig, loss: PositionLoss) -> str:
    """Keep what was seen, durably; return the id of the entry."""
    serial = config.robot(loss.robot).serial
    seen = {
        "detected_by": loss.detected_by,
        "mode": loss.suspicion.mode.value,
        "words": loss.suspicion.words,
        "axes": list(loss.suspicion.axes),
        "alarms": to_jsonable_python(loss.alarms),
        "last_healthy": to_jsonable_python(loss.last_healthy),
    }
    name = f"watch-{uuid4().hex[:12]}"
    with open_journal(config) as journal:
        journal.append(name, Kind.STORED, stored_body(DETECTION, loss.robot, serial, seen), actor="watch")
    return name


def _hindrances(config: CellConfig, loss: PositionLoss) -> list[str]:
    """Say what keeps the recovery from being started without a person."""
    motion, watch, seen = config.motion_of(loss.robot), config.watch, loss.suspicion
    hindrances = (
        (seen.record_differs, "somebody may have mastered the robot on purpose"),
        (not (seen.record_differs or seen.may_run_alone), f"{seen.mode.value} needs a person's judgement"),
        (loss.follows_another, "what was reported before it has not been cleared by anybody"),
        (seen.not_known, f"nobody here knows the alarm {', '.join(seen.not_known)}"),
        (loss.last_healthy is None, "nobody saw the robot healthy before"),
        (not watch.recover_alone, "[watch] recover_alone is not set"),
        (not watch.cell_closed, "[watch] cell_closed is not confirmed"),
        (
            motion.level is not MotionLevel.COMMANDED,
            f'the robot\'s motion is "{motion.level}", not "commanded"',
        ),
        (not motion.surroundings.known, "nobody said what stands in the cell ([robot.space])"),
    )
    return [why for stands, why in hindrances if stands]
