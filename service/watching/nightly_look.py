"""One look at every robot of a cell, all at once, for a timer at night: what it found of each, and an exit code."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import WrongDeviceError
from cellcal.drivers.interfaces import Condition, PositionCure, Readiness, Robot
from cellcal.drivers.registry import RobotConfig
from cellcal.procedures.robot_condition import read_reached_condition
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.exit_codes import ExitCode, gravest_exit_code
from cellcal.service.record.journal_files import lease_folder
from cellcal.service.record.robot_lock import DEVICES, is_held
from cellcal.service.unexpected_errors import describe_unexpected
from cellcal.service.watching.follow import RobotWatches
from cellcal.service.watching.loss_response import answer_to
from cellcal.service.watching.mastering_comparison import journalled_mastering
from cellcal.service.watching.position_comparison import PositionComparison, PositionLook
from cellcal.service.watching.watch import PositionLoss, RobotWatch
from cellcal.service.watching.watch_coverage import describe_coverage
from cellcal.service.watching.zero_comparisons import ZeroComparisons


class NightState(StrEnum):
    """How one robot was found."""

    UNCHANGED = "unchanged"
    CHANGED = "changed"
    LOST = "position lost"
    NOT_COMPARED = "not compared"
    NOT_SHOWN = "nothing shown"  # by a link that shows no zero, which a person has accepted
    FAILED = "not read"


_EXIT_CODES = {
    NightState.LOST: ExitCode.OUT_OF_TOLERANCE,
    NightState.CHANGED: ExitCode.OUT_OF_TOLERANCE,
    NightState.FAILED: ExitCode.UNREACHABLE,
    NightState.NOT_COMPARED: ExitCode.REFUSED,
    NightState.NOT_SHOWN: ExitCode.PASS,
    NightState.UNCHANGED: ExitCode.PASS,
}


_ONLY_A_RECORD = (
    "--accept does not answer its mastering, which is compared with its mastering record: after work at it, take a "
    "new one (mastering_record)."
)


@dataclass(frozen=True, slots=True)
class LookedAtRobot:
    """What one look found of one robot."""

    robot: str
    state: NightState
    sentence: str


def night_exit_code(found: Sequence[LookedAtRobot]) -> ExitCode:
    """Return the exit code of a whole cell; the gravest state counts."""
    return gravest_exit_code(_EXIT_CODES[each.state] for each in found)


async def look_at_cell(
    config: CellConfig, *, accept: frozenset[str] = frozenset(), report: Callable[[LookedAtRobot], None]
) -> tuple[LookedAtRobot, ...]:
    """Look at every robot; what a robot in ``accept`` shows is taken as right. ``report`` gets each as it comes."""

    async def look(entry: RobotConfig) -> LookedAtRobot:
        found = await _look_at(config, entry, accept=entry.name in accept)
        report(found)
        return found

    return tuple(await asyncio.gather(*(look(entry) for entry in config.robots)))


async def _look_at(config: CellConfig, entry: RobotConfig, *, accept: bool) -> LookedAtRobot:
    try:
        if is_held(lease_folder(config), entry.serial, DEVICES):
            return LookedAtRobot(entry.name, NightState.FAILED, "another cellcal works with it now.")
        async with entry.open() as robot:
            return await _look_over(config, entry, robot, accept=accept)
    except WrongDeviceError as error:
        return LookedAtRobot(entry.name, NightState.CHANGED, str(error))
    except CellError as error:
        return LookedAtRobot(entry.name, NightState.FAILED, str(error))
    except Exception as error:  # noqa: BLE001  a fault of ours with one robot must not hide the others
        return LookedAtRobot(entry.name, NightState.FAILED, join_messages(" ", describe_unexpected(error)))


async def _look_over(config: CellConfig, entry: RobotConfig, robot: Robot, *, accept: bool) -> LookedAtRobot:
    losses: list[PositionLoss] = []
    remarks: list[str] = []

    def add_remark(text: str) -> None:
        if text not in remarks:
            remarks.append(text)

    async def on_loss(loss: PositionLoss) -> None:
        losses.append(loss)

    watch = RobotWatches(config, on_loss, add_remark).watch_of(entry.name, robot)
    position = _position_of(watch)
    if accept:
        remarks.append(await _accept_shown(position, robot))
    await watch.look_once()
    if watch.condition.readiness is Readiness.UNREACHABLE:
        return LookedAtRobot(entry.name, NightState.FAILED, _words_of(watch.condition))
    if losses:
        answer_to(config, losses[0])
        lost = watch.condition.readiness is Readiness.POSITION_LOST
        text = make_message(
            "{detected_by}: {words}.", detected_by=losses[0].detected_by, words=losses[0].suspicion.words
        )
        state = NightState.LOST if lost else NightState.CHANGED
        return LookedAtRobot(entry.name, state, join_messages(" ", filter(None, (text, *remarks))))
    if robot.capabilities.reads_mastering:
        state, text = _describe_mastering(config, entry.serial)
    else:
        state, text = _describe_look(robot, None if position is None else position.last_look)
    stops = [_words_of(watch.condition)] if watch.condition.readiness is Readiness.STOPPED else []
    return LookedAtRobot(entry.name, state, join_messages(" ", filter(None, (text, *remarks, *stops))))


async def _accept_shown(position: PositionComparison | None, robot: Robot) -> str:
    """Take what a robot shows of its zero as right, where it shows any; return what was accepted, or why not."""
    if position is None:
        return _ONLY_A_RECORD
    if (await read_reached_condition(robot)).readiness is Readiness.POSITION_LOST:
        return "--accept: nothing was accepted, for its position is lost now."
    look_before = await position.look(robot)
    if not (await position.look(robot, accept=True)).is_kept:
        return "--accept: nothing was accepted, for it cannot be kept."
    texts = [_ONLY_A_RECORD] if robot.capabilities.reads_mastering else []
    if look_before.trouble is not None:
        texts.append(
            make_message(
                "--accept: a person has judged this to be right: {trouble}.", trouble=look_before.trouble[0]
            )
        )
    elif look_before.compared_with:
        texts.append("--accept: there was nothing to answer.")
    return join_messages(" ", texts)


def _position_of(watch: RobotWatch) -> PositionComparison | None:
    """Return what compares with earlier looks, where the robot has that."""
    comparison = watch.comparison
    if isinstance(comparison, ZeroComparisons):
        return comparison.position
    return comparison if isinstance(comparison, PositionComparison) else None


def _describe_mastering(config: CellConfig, serial: str) -> tuple[NightState, str]:
    """Say what the mastering of a robot that shows no trouble was compared with."""
    if journalled_mastering(config, serial)().record is not None:
        return NightState.UNCHANGED, "as in its mastering record."
    text = "its mastering was compared with nothing: there is no mastering record of it that can be read."
    return NightState.NOT_COMPARED, text


def _describe_look(robot: Robot, look: PositionLook | None) -> tuple[NightState, str]:
    """Say what a robot that shows no trouble was compared with."""
    shows = robot.capabilities
    if look is None:  # its controller did not answer
        return NightState.NOT_COMPARED, "nothing of its zero was compared."
    if look.compared_with:
        texts = [make_message("as in {compared_with}.", compared_with=look.compared_with)]
        if shows.position_cure is PositionCure.MASTERING_GAUGE:
            texts.append(
                "No variable tells of an axis that was unmastered and mastered again between two looks."
            )
        state = NightState.NOT_COMPARED if look.gap else NightState.UNCHANGED
        return state, join_messages(" ", texts)
    if shows.shows_position_data or shows.keeps_position_history:
        if not look.is_kept:
            return NightState.NOT_COMPARED, "its zero was compared with nothing, and nothing is kept of it."
        first = "looked at for the first time: what it shows of its zero is kept for the next night."
        return NightState.NOT_COMPARED, first
    coverage = describe_coverage(shows)
    if not look.accepted_utc:
        text = make_message(
            "this link shows nothing of its zero: {coverage}. Who knows that, says so once with --accept.",
            coverage=coverage,
        )
        return NightState.NOT_COMPARED, text
    text = make_message(
        "this link shows nothing of its zero, as was accepted at {accepted_utc}: {coverage}.",
        accepted_utc=look.accepted_utc[:16],
        coverage=coverage,
    )
    return NightState.NOT_SHOWN, text


def _words_of(condition: Condition) -> str:
    return make_message(
        "{condition_message} {condition_remedy}",
        condition_message=condition.message,
        condition_remedy=condition.remedy,
    )
