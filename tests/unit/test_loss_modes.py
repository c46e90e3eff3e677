"""What alarms suggest, what is prepared for it, and when it starts without a question."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness, RobotCapabilities
from cellcal.procedures.cell import MotionLevel
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.configuration.motion_config import RobotMotion
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.record.healthy_counts import HealthyCounts
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_store import NEVER_BEFORE, RunStore, _datable_utc
from cellcal.service.watching.loss_modes import (
    LossKind,
    LossMode,
    battery_warning,
    old_backup,
    suspect_loss,
    suspect_return,
    turns_lost,
    with_zero_set_anew,
    wrong_robot,
)
from cellcal.service.watching.loss_response import DETECTION, answer_to, journal_detection, prepare_answer
from cellcal.service.watching.watch import PositionLoss

BATTERY = Alarm("SRVO-062", "BZAL alarm (Group:1 Axis:3)", 2, AlarmKind.TURNS)
ENCODER = Alarm("SRVO-068", "DTERR alarm (Group:1 Axis:4)", 3, AlarmKind.ENCODER)
CRASH = Alarm("SRVO-050", "CLALM alarm (Group:1 Axis:2)", 1, AlarmKind.COLLISION)
STRANGE = Alarm("SYST-001", "something else")
HEALTHY = HealthyCounts("fanuc", (1, 2, 3, 4, 5, 6), 4, "2026-01-01T00:00:00+00:00")


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    """Return a cell whose file lets recoveries start alone."""
    found = read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=60.0))
    allowed = {"recover_alone": True, "cell_closed": True}
    return replace(found, watch=found.watch.model_copy(update=allowed))


def make_loss(*alarms: Alarm, healthy: HealthyCounts | None = HEALTHY) -> PositionLoss:
    return PositionLoss("fanuc", "the controller reports", alarms, healthy, suspect_loss(alarms))


@pytest.mark.parametrize(
    ("alarms", "mode", "axes"),
    [
        ((), LossMode.MEMORY, ()),
        ((BATTERY,), LossMode.TURNS, (3,)),
        (
            (replace(BATTERY, code="SRVO-075", axis=0), replace(BATTERY, code="SRVO-038", axis=5)),
            LossMode.TURNS,
            (1, 6),
        ),
        ((BATTERY, ENCODER), LossMode.MOTOR, (4,)),
        ((BATTERY, ENCODER, CRASH), LossMode.GEOMETRY, (2,)),
        ((STRANGE,), LossMode.UNKNOWN, ()),
    ],
)
def test_the_gravest_alarm_speaks(alarms: tuple[Alarm, ...], mode: LossMode, axes: tuple[int, ...]) -> None:
    found = suspect_loss(alarms)
    assert (found.mode, found.axes) == (mode, axes)
    assert found.answering_procedure == "mastering_recovery"
    assert found.words


def test_an_old_backup_is_never_mended_alone_and_the_recovery_is_prepared(config: CellConfig) -> None:
    mastering_loss = PositionLoss("fanuc", "the mastering differs", (), HEALTHY, old_backup())
    answer = prepare_answer(config, mastering_loss)
    assert not answer.starts_unattended
    assert answer.procedure == "mastering_recovery"
    assert answer.reasons == ("the robot may have been mastered on purpose",)
    assert "on purpose" in mastering_loss.suspicion.words


@pytest.mark.parametrize(
    ("driver", "more"),
    [
        ("abb_web_services", {"model": "abb_irb1600_6_12"}),
        ("kuka_variables", {"model": "kuka_kr10r1420", "fastest_axis_deg_s": 410.0}),
    ],
)
def test_where_mastering_is_pendant_work_the_work_at_the_pendant_is_prepared_and_never_begun_alone(
    config: CellConfig, tmp_path: Path, driver: str, more: dict[str, object]
) -> None:
    table = "".join(f"{key} = {json.dumps(value)}\n" for key, value in more.items())
    path = tmp_path / "pendant.toml"
    path.write_text(
        f'[cell]\nname = "cell"\ndata_dir = "{tmp_path}"\n[[robot]]\nname = "fanuc"\ndriver = "{driver}"\n{table}'
        'address = "127.0.0.1"\nserial = "1"\nspeed_limit_rad_s = 0.3\n'
    )
    pendant = replace(read_cell_file(path), watch=config.watch)
    answer = prepare_answer(pendant, make_loss(BATTERY, ENCODER))
    assert (answer.procedure, dict(answer.settings)) == ("position_cure", {})
    assert answer.command == f"cellcal run position_cure --cell {path} --robot fanuc"
    assert "its mastering is set at the pendant only" in answer.reasons
    assert not answer.starts_unattended


def test_a_closed_cell_that_allows_it_recovers_turns_alone(config: CellConfig) -> None:
    answer = prepare_answer(config, make_loss(BATTERY))
    assert answer.starts_unattended
    assert answer.command == f"cellcal run mastering_recovery --cell {config.path} --robot fanuc"


def test_a_loss_after_an_uncleared_alarm_is_left_to_a_person(config: CellConfig) -> None:
    answer = prepare_answer(config, replace(make_loss(BATTERY), follows_another=True))
    assert not answer.starts_unattended
    assert answer.reasons == ("what was reported before it has not been cleared by anybody",)


def test_a_loss_during_a_run_starts_no_automatic_recovery(config: CellConfig) -> None:
    answer = prepare_answer(config, replace(make_loss(BATTERY), during_run=True))
    assert answer.reasons == ("a run had the robot when it was lost: who works there has to judge",)


def test_what_was_reported_or_begun_since_the_robot_was_healthy_starts_nothing_after_a_restart(
    config: CellConfig,
) -> None:
    met = ("it was reported or answered before, and the robot was not seen healthy since",)
    earlier = replace(HEALTHY, seen_utc=(datetime.now(UTC) - timedelta(hours=1)).isoformat())
    first, _ = answer_to(config, make_loss(BATTERY, healthy=earlier))
    again, _ = answer_to(config, make_loss(BATTERY, healthy=earlier))
    assert first.starts_unattended
    assert again.reasons == met
    later = replace(HEALTHY, seen_utc=datetime.now(UTC).isoformat())
    assert prepare_answer(config, make_loss(BATTERY, healthy=later)).starts_unattended
    header = {"procedure": "mastering_recovery", "cell": {"devices": [{"identity": {"serial": "F-104711"}}]}}
    with open_journal(config) as journal:
        journal.append("run", EventKind.STARTED, header)
    assert prepare_answer(config, make_loss(BATTERY, healthy=later)).reasons == met


def test_a_clock_that_was_set_back_starts_nothing_alone(config: CellConfig) -> None:
    ahead = replace(HEALTHY, seen_utc=(datetime.now(UTC) + timedelta(hours=1)).isoformat())
    answer_to(config, make_loss(BATTERY, healthy=ahead))
    again = prepare_answer(config, make_loss(BATTERY, healthy=ahead))  # after a restart, at any time
    assert again.reasons == ("it was reported or answered before, and the robot was not seen healthy since",)


@pytest.mark.parametrize(("earlier", "datable"), [(["11:04", "11:05"], True), (["11:59", "11:04"], False)])
def test_an_event_after_a_clock_was_set_back_counts_as_later_than_anything(
    earlier: list[str], datable: bool
) -> None:
    times = [f"2026-11-30T{time}:00.000+00:00" for time in (*earlier, "11:05", "12:30")]
    events: Any = [SimpleNamespace(wall_utc=time) for time in times]
    assert _datable_utc(events, 2) == (times[2] if datable else NEVER_BEFORE)


def test_a_journal_that_is_damaged_may_hide_an_answer_and_starts_nothing(config: CellConfig) -> None:
    journal_detection(config, make_loss(BATTERY))
    path = journal_path(config)
    path.write_bytes(b"no database" * 100)
    answer, entry = answer_to(config, make_loss(BATTERY))
    assert not answer.starts_unattended
    assert entry == ""
    assert answer.reasons[-1] == "it could not be journalled"


def test_an_exchanged_motor_is_prepared_and_left_to_a_person(config: CellConfig) -> None:
    answer = prepare_answer(config, make_loss(BATTERY, ENCODER))
    assert answer.settings == {"exchanged_axes": (4,)}
    assert "--set exchanged_axes=[4]" in answer.command
    assert not answer.starts_unattended
    assert "judgement" in answer.reasons[0]


def test_each_missing_permission_is_named(config: CellConfig) -> None:
    open_watch = config.watch.model_copy(update={"recover_alone": False, "cell_closed": False})
    forbidden = replace(config, watch=open_watch, motions={"fanuc": RobotMotion(MotionLevel.OBSERVE)})
    answer = prepare_answer(forbidden, make_loss(BATTERY, healthy=None))
    assert not answer.starts_unattended
    reasons = "; ".join(answer.reasons)
    for word in ("healthy", "recover_alone", "cell_closed", "observe", "[robot.space]"):
        assert word in reasons
    assert len(answer.reasons) == 5


@pytest.mark.parametrize("known_alarms", [(), (BATTERY,)])
def test_an_unknown_alarm_leaves_the_recovery_to_a_person(
    config: CellConfig, known_alarms: tuple[Alarm, ...]
) -> None:
    answer = prepare_answer(config, make_loss(*known_alarms, STRANGE))
    assert answer.procedure == "mastering_recovery"
    assert not answer.starts_unattended
    assert answer.reasons[-1] == "the alarm SYST-001 is unknown here"
    assert answer.reasons[0].startswith("unknown ") == (not known_alarms)


def test_another_robot_is_no_business_of_a_recovery(config: CellConfig) -> None:
    answer = prepare_answer(config, PositionLoss("fanuc", "serial", (), None, wrong_robot()))
    assert answer.procedure is None
    assert not answer.starts_unattended


def test_another_robot_in_place_of_the_recorded_one_has_not_lost_its_position() -> None:
    assert wrong_robot().loss_kind is LossKind.ANOTHER
    assert wrong_robot().headline_text == "is not what answers: another robot does"
    assert old_backup().loss_kind is LossKind.DIFFERS  # M5 as well, and the same robot


def test_a_collision_of_a_robot_that_still_knows_its_place_asks_for_a_drift_check() -> None:
    found = suspect_loss((CRASH,), position_lost=False)
    assert found.answering_procedure == "drift_check"
    assert found.headline_text == "may no longer stand where it thinks"


def test_a_failing_encoder_of_a_robot_that_still_knows_its_place_is_no_loss_yet() -> None:
    found = suspect_loss((ENCODER,), position_lost=False)
    assert (found.mode, found.axes, found.answering_procedure) == (LossMode.MOTOR, (4,), "drift_check")
    assert not found.may_run_unattended
    assert found.procedure_settings() == {}
    assert "mend it" in found.words


def test_what_was_seen_is_in_the_journal_and_is_no_run(config: CellConfig) -> None:
    name = journal_detection(config, make_loss(BATTERY))
    with open_journal(config) as journal:
        (event,) = journal.list_events(name)
        body = json.loads(event.body)
        assert body["what"] == DETECTION
        assert body["value"]["mode"] == "M1"
        assert body["value"]["last_healthy"]["counts"] == [1, 2, 3, 4, 5, 6]
        assert RunStore(journal).list_runs() == []
        assert RunStore(journal).mastering_record("F-104711") is None


def test_a_low_battery_is_reported_while_the_position_is_there() -> None:
    low = Alarm("SRVO-065", "BLAL alarm (Group:1 Axis:2)", 1, AlarmKind.BATTERY_LOW)
    words = battery_warning(RobotCapabilities(axes=6), Condition(Readiness.READY, alarms=(low,)))
    assert "switched ON" in words
    assert "J2" in words
    assert battery_warning(RobotCapabilities(axes=6), Condition(Readiness.READY)) == ""
    assert (
        battery_warning(RobotCapabilities(axes=6), Condition(Readiness.POSITION_LOST, alarms=(low, BATTERY)))
        == ""
    )


def test_a_controller_that_keeps_no_zero_is_not_said_to_get_it_back_exactly() -> None:
    lost = suspect_loss((BATTERY,))
    assert "comes back exactly" in lost.words
    anew = with_zero_set_anew(lost)
    assert "done anew" in anew.words
    assert (anew.mode, anew.axes, anew.answering_procedure) == (
        lost.mode,
        lost.axes,
        lost.answering_procedure,
    )
    for other in (suspect_loss((CRASH,)), suspect_return((1,)), turns_lost(()), old_backup()):
        assert (with_zero_set_anew(other).words == other.words) is not (
            other.mode is LossMode.TURNS and other.position_lost
        )
