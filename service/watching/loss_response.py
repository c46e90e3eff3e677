"""What is done about a loss: journalled, prepared, and started alone only where the cell file allows it.

A recovery that was started alone is told by WATCH as who began it. What the cell file answers in it, and what waits
for a person, stands in `standing_answers.py`.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from uuid import uuid4

from pydantic_core import to_jsonable_python

from cellcal.calibration.message import make_message
from cellcal.drivers.interfaces import RobotCapabilities
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_store import RunStore, stored_body
from cellcal.service.times import read_time
from cellcal.service.watching.loss_modes import Suspicion
from cellcal.service.watching.watch import PositionLoss

_LOG = logging.getLogger(__name__)
DETECTION = "loss_detection"
AT_PENDANT = "position_cure"
WATCH = "watch"  # who began a run that no person has started


@dataclass(frozen=True, slots=True)
class PreparedAnswer:
    """The procedure that answers a loss, the command to type, and why it is not started alone (empty: it is)."""

    procedure: str | None
    settings: Mapping[str, object]
    command: str
    reasons: tuple[str, ...]

    @property
    def starts_unattended(self) -> bool:
        """Whether the service may start it by itself."""
        return self.procedure is not None and not self.reasons


def answer_to(config: CellConfig, loss: PositionLoss) -> tuple[PreparedAnswer, str]:
    """Prepare the answer to a loss and journal what was seen; return it and the entry's id (empty: there is none)."""
    answer = prepare_answer(config, loss)
    try:
        return answer, journal_detection(config, loss)
    except StoreError as error:  # the eyes on the encoders matter more
        _LOG.warning("a loss of %s could not be journalled: %s", loss.robot, error)
        reasons_against = (*answer.reasons, "it could not be journalled")
        return replace(answer, reasons=reasons_against), ""


def prepare_answer(config: CellConfig, loss: PositionLoss) -> PreparedAnswer:
    """Prepare the answer to a loss. The last healthy counts are among a recovery's settings already."""
    suspicion = loss.suspicion
    procedure = _procedure_for(suspicion, config.robot_named(loss.robot).capabilities)
    settings = {} if procedure == AT_PENDANT else suspicion.procedure_settings()
    option_text = "".join(
        f" --set {key}={value if isinstance(value, str) else list(value)}".replace(", ", ",")
        for key, value in settings.items()
    )
    command = (
        f"cellcal run {procedure} --cell {config.path} --robot {loss.robot}{option_text}" if procedure else ""
    )
    return PreparedAnswer(procedure, settings, command, tuple(_list_reasons_against(config, loss)))


def _procedure_for(suspicion: Suspicion, capabilities: RobotCapabilities) -> str | None:
    """Return the procedure that answers a loss; work at the pendant where no wire writes the mastering."""
    if capabilities.writes_mastering:
        return suspicion.answering_procedure
    lost = suspicion.answering_procedure == "mastering_recovery"
    return AT_PENDANT if lost and capabilities.position_cure is not None else None


def journal_detection(config: CellConfig, loss: PositionLoss) -> str:
    """Keep what was seen, durably; return the id of the entry."""
    serial = config.robot_named(loss.robot).serial
    detection = {
        "detected_by": loss.detected_by,
        "mode": loss.suspicion.mode.value,
        "words": loss.suspicion.words,
        "axes": list(loss.suspicion.axes),
        "alarms": to_jsonable_python(loss.alarms),
        "last_healthy": to_jsonable_python(loss.last_healthy),
    }
    name = f"watch-{uuid4().hex[:12]}"
    with open_journal(config) as journal:
        journal.append(
            name, EventKind.STORED, stored_body(DETECTION, loss.robot, serial, detection), actor=WATCH
        )
    return name


def _list_reasons_against(config: CellConfig, loss: PositionLoss) -> list[str]:
    """Say what keeps the recovery from being started without a person."""
    motion, watch, suspicion = config.motion_of(loss.robot), config.watch, loss.suspicion
    reasons_against = (
        (
            not config.robot_named(loss.robot).capabilities.writes_mastering,
            "its mastering is set at the pendant only",
        ),
        (
            not config.robot_named(loss.robot).capabilities.jogs_single_axes,
            "its axes are jogged at the pendant only",
        ),
        (suspicion.record_differs, "the robot may have been mastered on purpose"),
        (
            not (suspicion.record_differs or suspicion.may_run_unattended),
            make_message("{mode_value} needs a person's judgement", mode_value=suspicion.mode.value),
        ),
        (loss.follows_another, "what was reported before it has not been cleared by anybody"),
        (
            suspicion.not_known,
            make_message("the alarm {not_known} is unknown here", not_known=", ".join(suspicion.not_known)),
        ),
        (loss.during_run, "a run had the robot when it was lost: who works there has to judge"),
        (loss.last_healthy is None, "the robot was not seen healthy before"),
        (
            _met_before(config, loss),
            "it was reported or answered before, and the robot was not seen healthy since",
        ),
        (not watch.recover_alone, "[watch] recover_alone is not set"),
        (not watch.cell_closed, "[watch] cell_closed is not confirmed"),
        (
            motion.level is not MotionLevel.COMMANDED,
            make_message('the robot\'s motion is "{level}", not "commanded"', level=motion.level),
        ),
        (not motion.surroundings.is_known, "what stands in the cell is not described ([robot.space])"),
    )
    return [why for stands, why in reasons_against if stands]


def _met_before(config: CellConfig, loss: PositionLoss, *, now_utc: datetime | None = None) -> bool:
    """Return whether something was seen or begun since the robot was healthy last: a restart must not forget it."""
    procedure, healthy = loss.suspicion.answering_procedure, loss.last_healthy
    if procedure is None or healthy is None or not journal_path(config).exists():
        return False
    serial = config.robot_named(loss.robot).serial
    try:
        with open_journal(config) as journal:
            store = RunStore(journal)
            met = (store.last_begun_utc(procedure, serial), store.last_stored_utc(DETECTION, serial))
    except StoreError:  # what a damaged journal does not tell may have been
        return True
    healthy_utc = read_time(healthy.seen_utc)
    if healthy_utc > (now_utc or datetime.now(UTC)):  # the clock was set back: what came first is not known
        return True
    return any(at_utc is not None and read_time(at_utc) > healthy_utc for at_utc in met)
