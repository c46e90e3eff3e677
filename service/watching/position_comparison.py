"""Whether a controller whose mastering no wire writes shows the zero of its record, and what its log tells since.

Calibration offsets of an ABB, absolute data of a Yaskawa, mastering angles of a KUKA and the factory data of a UR do
not change by themselves; and a log tells of a position that was lost and brought back between two looks. Neither
raises an alarm. What is found is told at each look until a new position record is taken, a cure that was proved by
measurement has passed, or a person accepts it.
"""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, cast

from cellcal.calibration.mastering.position_record import ArmPositionRecord, ShownValue
from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import (
    Alarm,
    AlarmKind,
    Condition,
    KeepsPositionHistory,
    PositionHistory,
    Robot,
    TellsPositionData,
)
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal import StoreError
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.proved_cures import ProvedCure
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.shown_positions import Datum, KeptPosition, KeptPositions
from cellcal.service.watching.loss_modes import Suspicion, old_backup, suspect_return

_LOG = logging.getLogger(__name__)
LOOK_EVERY_S = 600.0
Trouble = tuple[str, Suspicion]
_NO_LOG = PositionHistory((), (), is_whole=True)


@dataclass(frozen=True, slots=True)
class ZeroReference:
    """What a controller's zero rests on: its position record, or a cure that passed after it."""

    record: ArmPositionRecord | None = None
    cure: ProvedCure | None = None  # that passed after the record: what was shown in it is right since then
    unproved_run: str = ""  # of a cure after both whose lengths proved nothing, or that an axis is wrong
    mastering_sha256: str = ""  # of the newest mastering record, of a robot that has one

    @property
    def key(self) -> str:
        """What tells this reference from others; "" for none."""
        if self.cure is not None:
            return self.cure.run_id
        return self.mastering_sha256 if self.record is None else self.record.measured.sha256

    def recorded_data(self) -> dict[Datum, str]:
        """Return the data of the record, or of the cure that has replaced it."""
        if self.cure is not None:
            return _zero_data(self.cure.shown)
        return {} if self.record is None else _zero_data(self.record.shown)


@dataclass(frozen=True, slots=True)
class PositionLook:
    """What one look found: what it was compared with, in words what is wrong, and what was not seen."""

    compared_with: str  # "": nothing, it was the first look
    trouble: Trouble | None
    gap: str = ""  # what the log does not tell
    accepted_utc: str = ""  # when a person accepted last what is shown, or that nothing is
    is_kept: bool = True  # False: the disk refused what the next look would compare with


class PositionComparison:
    """Compares what one controller shows with its position record and with what it showed before."""

    def __init__(
        self,
        memory: KeptPositions,
        serial: str,
        newest: Callable[[], ZeroReference],
        *,
        warn: Callable[[str], None] = _LOG.warning,
        look_every_s: float = LOOK_EVERY_S,
    ) -> None:
        self._memory, self._serial, self._newest = memory, serial, newest
        self._warn, self._look_every_s = warn, look_every_s
        self._next_s = 0.0
        self._has_noted_loss = False
        self.last_look: PositionLook | None = None

    def force_check(self) -> None:
        """Look at the next opportunity: a run may have taken a record."""
        self._next_s, self._has_noted_loss = 0.0, False

    async def find_trouble(self, robot: Any) -> Trouble | None:
        """Return in words what is wrong, and what is suspected; None: nothing. Between two looks the last stands."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._has_noted_loss = False
            self.last_look = await self.look(robot)
            self._next_s = now_s + self._look_every_s
            if self.last_look.gap:
                self._warn(f"{robot.name}: {self.last_look.gap}")
        return None if self.last_look is None else self.last_look.trouble

    async def look(self, robot: Robot, *, accept: bool = False) -> PositionLook:
        """Compare once; what is as before, or is accepted by a person, is kept for the next look.

        Raises
        ------
        DeviceError
            The controller does not answer.
        """
        reference, has_log = self._newest(), robot.capabilities.keeps_position_history
        baseline = self._valid_baseline(robot.name, reference)
        last = baseline or KeptPosition(robot.name, self._serial, {}, (), "", "")
        shown = await _data_of(robot)
        history = await _history_of(robot, last.marks)
        present, before = _zero_data(shown), {**reference.recorded_data(), **last.values}
        trouble = _find_trouble(before, present, history, baseline) or _find_unproved(reference, last)
        trouble = None if accept else trouble
        gap = "" if baseline is None or history.is_whole else _describe_gap(baseline)
        absent = sorted({name for name, axis in before if (name, axis) not in present})
        if absent:
            unseen = make_message("not shown this time, and not compared: {names}.", names=", ".join(absent))
            gap = join_messages(" ", filter(None, (gap, unseen)))
        is_kept = True
        if trouble is None:
            values, marks = {**before, **present}, history.marks or last.marks
            key = reference.key or last.reference_key
            baseline_now = KeptPosition(robot.name, self._serial, values, marks, key, "")
            accepted_utc = datetime.now(UTC).isoformat() if accept else last.accepted_utc
            newest = replace(baseline_now, answered_run=reference.unproved_run, accepted_utc=accepted_utc)
            is_kept = self._store_baseline(newest)
            last = newest if is_kept else last
        compared_with = (
            _compared_with(reference, baseline, has_data=bool(before)) if before or has_log else ""
        )
        return PositionLook(compared_with, trouble, gap, last.accepted_utc, is_kept)

    def note_loss(self, robot: str, condition: Condition) -> None:
        """Keep that a lost position was seen: it is told until a record, a proved cure or a person answers it.

        A controller without a log shows nothing of it once the position was brought back.
        """
        self._next_s = 0.0
        if self._has_noted_loss:
            return  # the journal need not be read at each look while the position is lost
        self._has_noted_loss = True
        reference = self._newest()
        last = self._valid_baseline(robot, reference)
        if last is None:
            now_utc = datetime.now(UTC).isoformat()
            last = KeptPosition(robot, self._serial, {}, (), reference.key, now_utc)
        if last.lost_utc:
            return
        axes = sorted({alarm.axis + 1 for alarm in condition.alarms if alarm.axis is not None})
        lost_utc = datetime.now(UTC).isoformat()
        baseline = replace(last, lost_utc=lost_utc, lost_words=condition.message, lost_axes=tuple(axes))
        self._store_baseline(baseline, seen_utc=last.seen_utc)

    def _valid_baseline(self, robot: str, reference: ZeroReference) -> KeptPosition | None:
        baseline = self._memory.load(robot)
        is_valid = baseline is not None and _is_valid(baseline, self._serial, reference)
        return baseline if is_valid else None

    def _store_baseline(self, baseline: KeptPosition, *, seen_utc: str = "") -> bool:
        """Keep it for the next look; return whether the disk took it."""
        try:
            self._memory.save(replace(baseline, seen_utc=seen_utc or datetime.now(UTC).isoformat()))
        except OSError as error:  # the eyes on the robot matter more than the disk
            self._warn(
                make_message(
                    "{robot}: what it shows cannot be kept: {reason}.",
                    robot=baseline.robot,
                    reason=error.strerror or error,
                )
            )
            return False
        return True


def journalled_position(config: CellConfig, serial: str) -> Callable[[], ZeroReference]:
    """Return what reads the newest position record of a robot, and a cure after it, from the cell's journal."""

    def read_journal() -> ZeroReference:
        if not journal_path(config).exists():
            return ZeroReference()
        try:
            with open_journal(config) as journal:
                store = RunStore(journal)
                mastering = store.mastering_record(serial)
                sha256 = "" if mastering is None else mastering.sha256
                return ZeroReference(
                    store.position_record(serial), *store.cures_since_record(serial), mastering_sha256=sha256
                )
        except StoreError as error:
            _LOG.warning("what the controller shows is not compared with its position record: %s", error)
            return ZeroReference()

    return read_journal


def _is_valid(baseline: KeptPosition, serial: str, reference: ZeroReference) -> bool:
    """Return whether what was kept is of this robot, and no record or cure since then tells what is right."""
    return baseline.serial == serial and reference.key in ("", baseline.reference_key)


def _compared_with(reference: ZeroReference, baseline: KeptPosition | None, *, has_data: bool) -> str:
    if baseline is not None and not has_data:
        return make_message("the look of {seen_utc}, by its log alone", seen_utc=baseline.seen_utc[:16])
    if baseline is not None:
        return make_message("the look of {seen_utc}", seen_utc=baseline.seen_utc[:16])
    if reference.cure is not None:
        return make_message("the cure {run_id}", run_id=reference.cure.run_id) if has_data else ""
    return "" if reference.record is None else "the position record"


async def _data_of(robot: Robot) -> tuple[ShownValue, ...]:
    if not robot.capabilities.shows_position_data:
        return ()
    return await cast(TellsPositionData, robot).position_data()


async def _history_of(robot: Robot, since: tuple[str, ...]) -> PositionHistory:
    if not robot.capabilities.keeps_position_history:
        return _NO_LOG
    try:
        return await cast(KeepsPositionHistory, robot).position_history(since)
    except RefusedError:
        return PositionHistory((), (), is_whole=False)


def _zero_data(shown: tuple[ShownValue, ...]) -> dict[Datum, str]:
    data = (each for each in shown if each.is_constant or each.is_zero or each.is_set)
    return {(each.name, each.axis): each.value for each in data}


def _find_trouble(
    before: Mapping[Datum, str],
    present: Mapping[Datum, str],
    history: PositionHistory,
    baseline: KeptPosition | None,
) -> Trouble | None:
    changed = [key for key in before if key in present and not _is_same(before[key], present[key])]
    if changed:
        return _describe_change(changed, before, present), old_backup()
    lost = tuple(alarm for alarm in history.alarms if alarm.kind is AlarmKind.TURNS)
    if baseline is None or not lost:
        return None
    axes = sorted({alarm.axis + 1 for alarm in lost if alarm.axis is not None})
    return _describe_return(lost, baseline), suspect_return(tuple(axes))


def _find_unproved(reference: ZeroReference, last: KeptPosition) -> Trouble | None:
    """Return the loss that was seen, or the cure that proved nothing, since the zero was known."""
    if last.lost_utc:
        text = make_message(
            "at {lost_utc} the controller showed a lost position, and shows nothing of it any more: {words}",
            lost_utc=last.lost_utc[:16],
            words=last.lost_words,
        )
        return text, suspect_return(last.lost_axes)
    if reference.unproved_run and reference.unproved_run != last.answered_run:
        text = make_message(
            "run {run_id} did not prove that its position was brought back rightly",
            run_id=reference.unproved_run,
        )
        return text, suspect_return(())
    return None


def _is_same(before: str, now: str) -> bool:
    """Return whether two texts say the same; numbers may be written with more or fewer zeros."""
    try:
        return before == now or float(before) == float(now)
    except ValueError:
        return False


def _describe_change(changed: list[Datum], before: Mapping[Datum, str], now: Mapping[Datum, str]) -> str:
    texts = [
        f"{name}{'' if axis is None else f' {axis + 1}'}: {before[name, axis]}, {now[name, axis]}"
        for name, axis in changed
    ]
    return make_message("the controller shows another zero than before, and no alarm tells of it: {axes}",
                        axes="; ".join(texts))  # fmt: skip


def _describe_return(lost: tuple[Alarm, ...], baseline: KeptPosition) -> str:
    return make_message(
        "since the look of {seen_utc} the controller logged {events}, and shows nothing of it any more",
        seen_utc=baseline.seen_utc[:16],
        events="; ".join(f"{alarm.code} {alarm.text}" for alarm in lost),
    )


def _describe_gap(baseline: KeptPosition) -> str:
    return make_message(
        "the controller's log does not reach back to the look of {seen_utc}: whether its position was lost since is "
        "not known.",
        seen_utc=baseline.seen_utc[:16],
    )
