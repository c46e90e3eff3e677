"""The main job through the command that a newcomer types: real processes, sockets, the world's truth."""

import json
import os
import subprocess
import sys

import pytest

from tests.chance import FAR_OUTSIDE
from tests.machine_speed import stretched_s

KEYS = {
    *("loss", "detected_by", "captures", "joints", "verdict", "reason"),
    *("tcp_error_before_m", "tcp_error_after_m", "robot_time_s"),
    *("clock_s", "clock_parts_s"),
}
JOINT_KEYS = {"name", "turns_lost", "turns_restored", "offset_error_rad", "offset_u_rad"}


def run_demo(loss: str, seed: int, *more: str) -> tuple[int, dict]:
    command = [sys.executable, "-m", "cellcal", "demo", "--headless", "--json", "--loss", loss, *more]
    ended = subprocess.run(
        [*command, "--seed", str(seed), "--time-factor", "1000"], capture_output=True,
        timeout=stretched_s(280.0), text=True, env=os.environ | {"OPENBLAS_NUM_THREADS": "1"}, check=False,
    )  # fmt: skip
    assert ended.stdout.count("\n") == 1, ended.stderr[-2000:]  # one object and nothing else
    return ended.returncode, json.loads(ended.stdout)


def test_lost_turns_are_restored_exactly() -> None:  # further seeds: make soak ARGS="turns motor"
    code, demo_report = run_demo("turns", 11)
    assert set(demo_report) == KEYS
    assert all(set(joint) == JOINT_KEYS for joint in demo_report["joints"])
    assert (code, demo_report["verdict"]) == (0, "PASS")
    assert "SRVO-062" in demo_report["detected_by"]
    assert any(abs(joint["turns_lost"]) > 5 for joint in demo_report["joints"])  # the world did take them
    assert [j["turns_restored"] for j in demo_report["joints"]] == [
        j["turns_lost"] for j in demo_report["joints"]
    ]
    assert all(joint["offset_error_rad"] == 0.0 for joint in demo_report["joints"])
    assert demo_report["tcp_error_before_m"]["mean"] > 0.1
    assert demo_report["tcp_error_after_m"]["max"] < 1e-9


@pytest.mark.soak  # more: make soak ARGS="demo_robots"
def test_lost_turns_of_another_makers_arm_are_restored_exactly() -> None:
    code, output = run_demo("turns", 1, "--robot", "staubli_tx2_90l")
    assert (code, output["verdict"]) == (0, "PASS")
    assert any(abs(joint["turns_lost"]) > 5 for joint in output["joints"])
    assert [j["turns_restored"] for j in output["joints"]] == [j["turns_lost"] for j in output["joints"]]
    assert output["tcp_error_before_m"]["mean"] > 0.1
    assert output["tcp_error_after_m"]["max"] < 1e-9


def test_an_exchanged_motor_is_distinguished_and_stays_inside_its_uncertainty() -> None:
    code, demo_report = run_demo("motor:J3", 21)
    assert (code, demo_report["verdict"]) == (0, "PASS")
    exchanged = demo_report["joints"].pop(2)
    assert abs(exchanged["offset_error_rad"]) <= FAR_OUTSIDE * exchanged["offset_u_rad"]
    assert exchanged["offset_u_rad"] < 2e-3
    assert all(joint["turns_restored"] == joint["turns_lost"] for joint in demo_report["joints"])
    assert demo_report["tcp_error_after_m"]["max"] < 2e-3


@pytest.mark.soak
def test_every_reference_lost_is_mastered_by_measurement() -> None:
    code, demo_report = run_demo("all", 31)
    assert (code, demo_report["verdict"]) == (0, "PASS")
    assert all(0.0 < joint["offset_u_rad"] < 2e-2 for joint in demo_report["joints"])
    assert all(
        abs(joint["offset_error_rad"]) <= FAR_OUTSIDE * joint["offset_u_rad"]
        for joint in demo_report["joints"]
    )


@pytest.mark.soak  # the recovery itself refuses it in tests/procedures; this is the same over sockets
def test_a_bent_arm_is_refused_and_nothing_is_written() -> None:
    code, demo_report = run_demo("crash", 41)
    assert (code, demo_report["verdict"]) == (4, "REFUSED")
    assert "full calibration" in demo_report["reason"]
    assert all(joint["turns_restored"] == 0 for joint in demo_report["joints"])


@pytest.mark.parametrize("loss", ["memory", pytest.param("backup", marks=pytest.mark.soak)])
def test_mastering_data_that_are_wrong_without_a_lost_encoder_are_put_right(loss: str) -> None:
    code, demo_report = run_demo(loss, 5)
    assert (code, demo_report["verdict"]) == (0, "PASS")
    assert demo_report["tcp_error_before_m"]["max"] > 1e-3
    assert demo_report["tcp_error_after_m"]["max"] < 1e-9
    assert all(joint["turns_lost"] == joint["turns_restored"] == 0 for joint in demo_report["joints"])
    assert demo_report["clock_s"] > 0.0
    assert sum(demo_report["clock_parts_s"].values()) == pytest.approx(demo_report["clock_s"], rel=0.05)


@pytest.mark.soak
def test_another_arm_under_the_same_cabinet_gets_no_mastering() -> None:
    code, demo_report = run_demo("swap", 5)
    assert (code, demo_report["verdict"]) == (4, "REFUSED")
    assert demo_report["tcp_error_after_m"]["mean"] > 0.1  # nothing was written
    assert all(joint["turns_restored"] == 0 for joint in demo_report["joints"])


@pytest.mark.parametrize("loss", ["turn", "motor", "motor:J7", "motor:"])
def test_a_misspelt_loss_is_reported_before_anything_starts(loss: str) -> None:
    command = [sys.executable, "-m", "cellcal", "demo", "--headless", "--json", "--loss", loss]
    ended = subprocess.run(command, capture_output=True, timeout=stretched_s(280.0), text=True, check=False)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert "motor:J1" in ended.stderr
