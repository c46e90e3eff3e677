"""The watch sees a loss by three witnesses, once, and an unreachable robot is no loss."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.mastering.counts import DriveTrain, MasteringRecord
from cellcal.drivers.errors import UnreachableError, WireProtocolError
from cellcal.drivers.interfaces import (
    Alarm,
    AlarmKind,
    Condition,
    MasteringData,
    PositionCure,
    Readiness,
    RobotCapabilities,
)
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.record.healthy_counts import HealthyCounts, LastHealthyCounts, remember_healthy
from cellcal.service.record.unconfirmed_mastering import UnconfirmedMastering
from cellcal.service.watching import nightly_look
from cellcal.service.watching.loss_modes import LossKind, LossMode
from cellcal.service.watching.mastering_comparison import JournalledMastering, MasteringComparison
from cellcal.service.watching.watch import PositionLoss, RobotWatch

PER_COUNT = 2 * 3.141592653589793 / (524288 * 100)


@dataclass
class TwoAxisController:
    """Two axes; only what the watch asks for."""

    name: str = "arm"
    counts: tuple[int, ...] = (1000, 2000)
    epoch: int = 4
    readiness: Readiness = Readiness.READY
    alarms: tuple[Alarm, ...] = ()
    link_is_up: bool = True
    losses: list[PositionLoss] = field(default_factory=list)
    mastering_data: MasteringData = field(default_factory=lambda: MasteringData((0, 0), mastered=True))

    capabilities: RobotCapabilities = field(
        default_factory=lambda: RobotCapabilities(axes=2, reads_encoder_counts=True, writes_mastering=True)
    )

    async def read_condition(self) -> Condition:
        if not self.link_is_up:
            return Condition(Readiness.UNREACHABLE, "no answer")
        return Condition(self.readiness, " ".join(alarm.text for alarm in self.alarms), "", self.alarms)

    async def encoder_counts(self) -> tuple[int, ...]:
        if not self.link_is_up:
            raise UnreachableError(self.name, "no answer")
        return self.counts

    async def encoder_epoch(self) -> int:
        return self.epoch

    async def read_mastering(self) -> MasteringData:
        return self.mastering_data

    async def drive_train(self) -> DriveTrain:
        return DriveTrain(((PER_COUNT, 0.0), (0.0, PER_COUNT)), (524288, 524288))

    async def on_loss(self, loss: PositionLoss) -> None:
        self.losses.append(loss)


@pytest.fixture
def fake_arm() -> TwoAxisController:
    return TwoAxisController()


@pytest.fixture
def robot_watch(fake_arm: TwoAxisController, tmp_path: Path) -> RobotWatch:
    return RobotWatch(fake_arm, LastHealthyCounts(tmp_path), fake_arm.on_loss, period_s=0.01)  # type: ignore[arg-type]


async def test_an_alarm_is_seen_once_with_the_counts_from_before(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    assert await robot_watch.look_once() is None
    fake_arm.counts, fake_arm.readiness = (17, 23), Readiness.POSITION_LOST
    fake_arm.alarms = (Alarm("SRVO-062", "BZAL alarm (Group:1 Axis:1)", 0, AlarmKind.TURNS),)
    assert await robot_watch.look_once() is not None
    assert await robot_watch.look_once() is None
    (loss,) = fake_arm.losses
    assert "BZAL alarm" in loss.detected_by
    assert loss.last_healthy is not None
    assert loss.last_healthy.counts == (1000, 2000)


async def test_a_lost_mastering_that_is_made_with_a_gauge_is_not_said_to_come_back(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    fake_arm.capabilities = replace(
        fake_arm.capabilities, writes_mastering=False, position_cure=PositionCure.MASTERING_GAUGE
    )
    fake_arm.readiness = Readiness.POSITION_LOST
    fake_arm.alarms = (Alarm("MASTERING_LOST", "axis A1 is not mastered", 0, AlarmKind.TURNS),)
    loss = await robot_watch.look_once()
    assert loss is not None
    assert "done anew with the mastering gauge" in loss.suspicion.words


FAILS = Alarm("SRVO-068", "DTERR alarm (Group:1 Axis:2)", 1, AlarmKind.ENCODER)
EMPTY = Alarm("SRVO-062", "BZAL alarm (Group:1 Axis:1)", 0, AlarmKind.TURNS)


async def test_a_loss_after_a_failing_encoder_is_reported_too_and_may_mean_an_exchanged_one(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    await robot_watch.look_once()
    fake_arm.readiness, fake_arm.alarms = Readiness.NOT_READY, (FAILS,)
    failing = await robot_watch.look_once()
    fake_arm.link_is_up = False  # switched off and mended
    assert await robot_watch.look_once() is None
    fake_arm.link_is_up, fake_arm.readiness, fake_arm.alarms = True, Readiness.POSITION_LOST, (EMPTY,)
    lost = await robot_watch.look_once()
    assert await robot_watch.look_once() is None
    assert failing is not None
    assert lost is not None
    assert (failing.suspicion.loss_kind, failing.follows_another) == (LossKind.HELD, False)
    assert (lost.suspicion.loss_kind, lost.follows_another) == (LossKind.LOST, True)
    assert (lost.suspicion.mode, lost.suspicion.axes) == (LossMode.MOTOR, (2,))


async def test_a_failing_encoder_is_remembered_over_a_new_connection(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    await robot_watch.look_once()
    fake_arm.readiness, fake_arm.alarms = Readiness.NOT_READY, (FAILS,)
    await robot_watch.look_once()
    mended = replace(fake_arm, readiness=Readiness.POSITION_LOST, alarms=(EMPTY,))
    robot_watch.use_connection(mended)  # type: ignore[arg-type]
    lost = await robot_watch.look_once()
    assert lost is not None
    assert (lost.follows_another, lost.suspicion.mode) == (True, LossMode.MOTOR)


async def test_a_loss_is_of_a_run_until_the_robot_was_seen_healthy_after_it(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    await robot_watch.look_once()
    robot_watch.forget_motion()
    fake_arm.readiness, fake_arm.alarms = Readiness.POSITION_LOST, (EMPTY,)
    during = await robot_watch.look_once()
    assert not await robot_watch.is_resolved()
    fake_arm.readiness, fake_arm.alarms = Readiness.READY, ()
    await robot_watch.look_once()
    assert await robot_watch.is_resolved()
    fake_arm.readiness, fake_arm.alarms = Readiness.POSITION_LOST, (EMPTY,)
    after = await robot_watch.look_once()
    assert during is not None
    assert after is not None
    assert (during.during_run, after.during_run) == (True, False)


async def test_a_loss_of_a_robot_that_did_not_hold_its_record_is_reported_as_what_follows(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    watch = watch_with_records(fake_arm, tmp_path, [record_of((1, 1))])
    differs = await watch.look_once()
    fake_arm.readiness, fake_arm.alarms = Readiness.POSITION_LOST, (EMPTY,)
    lost = await watch.look_once()
    assert differs is not None
    assert lost is not None
    assert (differs.suspicion.loss_kind, lost.suspicion.mode) == (LossKind.DIFFERS, LossMode.TURNS)
    assert lost.follows_another


async def test_a_jump_beside_an_unknown_alarm_names_it(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    await robot_watch.look_once()
    fake_arm.counts = (1000 + 60 * 524288, 2000)
    fake_arm.readiness, fake_arm.alarms = Readiness.NOT_READY, (Alarm("SYST-001", "something else"),)
    found = await robot_watch.look_once()
    assert found is not None
    assert (found.suspicion.mode, found.suspicion.not_known) == (LossMode.TURNS, ("SYST-001",))


async def test_a_jump_without_motion_is_a_loss_even_without_an_alarm(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    await robot_watch.look_once()
    fake_arm.counts = (1000 + 60 * 524288, 2000)  # 216 degrees between two looks
    found = await robot_watch.look_once()
    assert found is not None
    assert "axis J1 jumped" in found.detected_by


async def test_ordinary_motion_is_no_loss(fake_arm: TwoAxisController, robot_watch: RobotWatch) -> None:
    for step in range(5):
        fake_arm.counts = (1000 + step * 200_000, 2000 - step * 100_000)
        assert await robot_watch.look_once() is None


async def test_a_new_epoch_is_a_loss_until_a_run_has_left_the_robot_healthy(
    fake_arm: TwoAxisController, robot_watch: RobotWatch, tmp_path: Path
) -> None:
    await robot_watch.look_once()
    fake_arm.epoch = 5
    assert await robot_watch.look_once() is not None
    await remember_healthy("arm", fake_arm, LastHealthyCounts(tmp_path))  # type: ignore[arg-type]
    assert await robot_watch.look_once() is None


async def test_a_disk_that_takes_nothing_is_reported_once_and_the_watch_goes_on(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    messages: list[str] = []
    watch = RobotWatch(
        fake_arm, LastHealthyCounts(tmp_path), fake_arm.on_loss, period_s=0.01, warn=messages.append
    )  # type: ignore[arg-type]
    (tmp_path / "last_healthy_arm.json").mkdir()  # no file can take its place
    for step in range(3):
        fake_arm.counts = (1000 + step, 2000)
        assert await watch.look_once() is None
    assert len(messages) == 1
    assert "arm: its healthy counts cannot be kept" in messages[0]
    fake_arm.readiness = Readiness.POSITION_LOST
    assert await watch.look_once() is not None


async def test_a_lost_link_is_no_loss_and_the_next_look_does_not_compare(
    fake_arm: TwoAxisController, robot_watch: RobotWatch
) -> None:
    await robot_watch.look_once()
    fake_arm.link_is_up = False
    assert await robot_watch.look_once() is None
    fake_arm.link_is_up, fake_arm.counts = True, (1000 + 60 * 524288, 2000)  # moved while we could not see
    assert await robot_watch.look_once() is None


def record_of(counts_at_zero: tuple[int, ...]) -> MasteringRecord:
    drive = DriveTrain(((PER_COUNT, 0.0), (0.0, PER_COUNT)), (524288, 524288))
    return MasteringRecord(
        "F-1",
        "fanuc_m6ib",
        4,
        drive,
        counts_at_zero,
        (0.0, 0.0),
        counts_at_zero,
        (),
        None,
        None,
        "test",
        "c0ffee",
    )


def watch_with_records(
    arm: TwoAxisController, folder: Path, records: list[MasteringRecord], every_s: float = 0.0
) -> RobotWatch:
    def journalled_record() -> JournalledMastering:
        return JournalledMastering(records[-1] if records else None)

    comparison = MasteringComparison(journalled_record, look_every_s=every_s)
    return RobotWatch(arm, LastHealthyCounts(folder), arm.on_loss, period_s=0.01, comparison=comparison)  # type: ignore[arg-type]


async def test_an_old_backup_raises_no_alarm_and_is_seen_once_until_it_is_mended(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    watch = watch_with_records(fake_arm, tmp_path, [record_of((0, 0))])
    assert await watch.look_once() is None
    fake_arm.mastering_data = MasteringData((0, 174763), mastered=True)
    found = await watch.look_once()
    assert found is not None
    assert "J2 by 1.200 deg" in found.detected_by
    assert "no alarm" in found.detected_by
    assert (found.suspicion.mode, found.suspicion.answering_procedure) == (
        LossMode.WRONG_ROBOT,
        "mastering_recovery",
    )
    assert not found.suspicion.may_run_unattended
    assert found.last_healthy is not None  # the encoders are fine: what they said serves the recovery
    assert await watch.look_once() is None
    assert watch.is_still_lost
    fake_arm.mastering_data = MasteringData((0, 0), mastered=True)
    assert await watch.look_once() is None
    assert not watch.is_still_lost
    fake_arm.mastering_data = MasteringData((1, 0), mastered=True)
    assert await watch.look_once() is not None  # the next one is told again


async def test_a_new_record_makes_the_robots_own_mastering_the_right_one(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    records = [record_of((0, 0))]
    watch = watch_with_records(fake_arm, tmp_path, records, every_s=3600.0)
    fake_arm.mastering_data = MasteringData((0, 9), mastered=True)
    assert await watch.look_once() is not None
    records.append(record_of((0, 9)))
    assert await watch.look_once() is None
    assert watch.is_still_lost  # between two looks the last answer stands
    watch.forget_motion()  # a run has ended
    await watch.look_once()
    assert not watch.is_still_lost


async def test_without_a_record_or_while_nothing_is_mastered_there_is_nothing_to_compare(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    fake_arm.mastering_data = MasteringData((0, 9), mastered=True)
    assert await watch_with_records(fake_arm, tmp_path, []).look_once() is None
    fake_arm.mastering_data = MasteringData((0, 9), mastered=False)
    assert await watch_with_records(fake_arm, tmp_path, [record_of((0, 0))]).look_once() is None


async def test_a_mastering_that_a_run_never_confirmed_is_shown_until_it_is_gone(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    old, new = MasteringData((0, 0), mastered=False), MasteringData((5, 7), mastered=True)
    pending = UnconfirmedMastering("mastering_recovery-1", new, old, 3)
    comparison = MasteringComparison(
        lambda: JournalledMastering(record_of((0, 0)), (pending,)), look_every_s=0.0
    )
    watch = RobotWatch(
        fake_arm, LastHealthyCounts(tmp_path), fake_arm.on_loss, period_s=0.01, comparison=comparison
    )  # type: ignore[arg-type]
    fake_arm.mastering_data = new
    found = await watch.look_once()
    assert found is not None
    assert (found.suspicion.loss_kind, found.suspicion.answering_procedure) == (
        LossKind.UNCONFIRMED,
        "mastering_undo",
    )
    assert found.suspicion.procedure_settings() == {"of_run": "mastering_recovery-1"}
    assert not found.suspicion.may_run_unattended
    fake_arm.mastering_data = MasteringData((5, 0), mastered=True)  # half of it
    assert await watch.look_once() is None
    assert watch.is_still_lost
    fake_arm.mastering_data = old
    assert await watch.look_once() is None
    assert not watch.is_still_lost


def test_the_memory_survives_a_restart_and_damage(tmp_path: Path) -> None:
    memory = LastHealthyCounts(tmp_path)
    assert memory.load_counts("arm") is None
    healthy_counts = HealthyCounts("arm", (1, -2), 7, "2026-01-01T00:00:00+00:00")
    memory.save_counts(healthy_counts)
    assert LastHealthyCounts(tmp_path).load_counts("arm") == healthy_counts
    (tmp_path / "last_healthy_arm.json").write_text('{"counts": [1')
    assert memory.load_counts("arm") is None


async def test_a_fault_of_ours_with_one_robot_does_not_hide_the_look_at_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0))

    def is_held(_folder: Path, serial: str, _right: str) -> bool:
        if serial == config.robots[0].serial:
            raise ZeroDivisionError("injected")
        return True

    monkeypatch.setattr(nightly_look, "is_held", is_held)
    broken, other = await nightly_look.look_at_cell(config, report=lambda _: None)
    assert (broken.state, other.state) == ("not read", "not read")
    assert "ZeroDivisionError: injected. The report is in " in broken.sentence
    assert other.sentence == "another cellcal works with it now."


@pytest.mark.parametrize(
    "damaged",
    [
        {"counts": (1000, 2000 + 524288 * 50)},
        {"counts": (1000, 2000, 3000)},
        {"epoch": 77},
        {"readiness": Readiness.POSITION_LOST},
    ],
)
async def test_one_damaged_answer_is_named_and_is_no_loss_and_a_loss_after_it_is_seen(
    fake_arm: TwoAxisController, tmp_path: Path, damaged: dict[str, Any]
) -> None:
    @dataclass
    class OnceDamaged(TwoAxisController):
        reads_left: int = 0  # of the damaged answer

        def healed(self) -> bool:
            self.reads_left -= 1
            return self.reads_left < 0

        async def encoder_counts(self) -> tuple[int, ...]:
            return self.counts if "counts" not in damaged or self.healed() else damaged["counts"]

        async def encoder_epoch(self) -> int:
            return self.epoch if "epoch" not in damaged or self.healed() else damaged["epoch"]

        async def read_condition(self) -> Condition:
            is_whole = "readiness" not in damaged or self.healed()
            return Condition(self.readiness if is_whole else damaged["readiness"], "lost", "", self.alarms)

    arm, memory = OnceDamaged(), LastHealthyCounts(tmp_path)
    watch = RobotWatch(arm, memory, arm.on_loss, period_s=0.01)  # type: ignore[arg-type]
    if "epoch" not in damaged:  # with counts kept from before, or at the first look after a connection
        await watch.look_once()
    for _ in range(3):
        arm.reads_left = 1
        with pytest.raises(WireProtocolError, match=r"contradict|told 2 encoder counts|asked again"):
            await watch.look_once()
        assert await watch.look_once() is None
        watch.forget_motion()
        assert await watch.look_once() is None
    saved = memory.load_counts(arm.name)
    assert saved is not None
    assert (saved.counts, saved.epoch) == ((1000, 2000), 4)
    assert arm.losses == []
    arm.epoch = 5
    assert await watch.look_once() is not None


async def test_counts_after_a_connection_are_kept_only_where_two_readings_agree(
    fake_arm: TwoAxisController, tmp_path: Path
) -> None:
    memory, answers = LastHealthyCounts(tmp_path), iter([(7, 8), (1000 + 524288 * 80, 2000)])

    async def read_counts() -> tuple[int, ...]:
        return next(answers)

    fake_arm.encoder_counts = read_counts  # type: ignore[method-assign]
    watch = RobotWatch(fake_arm, memory, fake_arm.on_loss, period_s=0.01)  # type: ignore[arg-type]
    with pytest.raises(WireProtocolError, match="contradict"):
        await watch.look_once()
    assert memory.load_counts(fake_arm.name) is None
