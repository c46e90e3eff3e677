"""Benchmarks: who is missing is named, claims are judged apart, and nothing but numbers is written."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.bench import identify, real
from cellcal.service.engineering.bench.compensate import judge_answers
from cellcal.service.engineering.bench.contestants import (
    OURS,
    PEERS,
    AbsentContestant,
    BenchError,
    Contestant,
    parse_interpreters,
    run_contestant,
)
from cellcal.service.engineering.bench.plots import write_results
from cellcal.service.engineering.bench.poses import determinant_root
from cellcal.service.engineering.bench.results import BenchResult, BenchTopic, as_document, take_turns
from cellcal.service.engineering.bench.simulated import draw_arms, draw_joints
from cellcal.service.engineering.bench.topics import TOPICS, choose_topics

ABSENT = Contestant("absent_peer", "roboticstoolbox_peer.py", "roboticstoolbox-python==1.5.0")


def small_inputs(count=50):
    both = draw_arms(0)
    joints = draw_joints(np.random.default_rng(1), count) * 0.5
    return both, {**both.to_inputs(), "joints": joints}


def test_ours_runs_in_its_own_process_and_is_right():
    both, inputs = small_inputs()
    answers = run_contestant(OURS, "compensate", inputs, {})
    result = judge_answers(OURS, both, inputs["joints"], answers)
    assert result.count == 50
    assert result.error < 1e-5
    assert result.notes["claimed_but_above_1e-5_mm"] == 0
    assert result.notes["solved_share"] > 0.9


def test_a_peer_that_is_not_installed_is_named_with_its_cure(tmp_path):
    program = tmp_path / "peer.py"
    program.write_text("def compensate(inputs, measure):\n    import a_peer_of_none\n", encoding="utf-8")
    absent_peer = Contestant("absent_peer", str(program), "a-peer-of-none==1.0")
    _, inputs = small_inputs(3)
    answer = run_contestant(absent_peer, "compensate", inputs, {})
    assert isinstance(answer, AbsentContestant)
    assert "not installed: a_peer_of_none (a-peer-of-none==1.0" in answer.reason
    assert "--peer-python absent_peer=" in answer.reason


def test_a_peer_that_breaks_is_named_too():
    answer = run_contestant(OURS, "compensate", {"joints": np.zeros((2, 6))}, {})
    assert isinstance(answer, AbsentContestant)
    assert answer.reason.startswith("failed: KeyError")


def test_false_claims_and_leaps_are_counted():
    both, inputs = small_inputs(4)
    joints = inputs["joints"]
    found = joints.copy()
    found[1, 0] += 2 * np.pi
    answers = {"joints": found, "claimed": np.array([1, 1, 1, 0]), "seconds": np.array(1.0)}
    result = judge_answers(PEERS[0], both, joints, answers)
    assert result.notes["leaps"] == 1
    assert result.notes["claimed_but_above_1e-5_mm"] == 3
    assert result.notes["solved_share"] == 0.75
    assert result.error > 0.1


def test_nothing_solved_can_still_be_written(tmp_path):
    both, inputs = small_inputs(2)
    answers = {"joints": inputs["joints"], "claimed": np.zeros(2), "seconds": np.array(1.0)}
    lost = judge_answers(PEERS[0], both, inputs["joints"], answers)
    topic = BenchTopic("compensate", "why", (lost,), (AbsentContestant(ABSENT, "not installed"),))
    document = as_document((topic,), 0, 1)
    row = json.loads(json.dumps(document, allow_nan=False))["topics"][0]["results"][0]
    assert row["error"] is None
    assert row["times_slower_than_cellcal"] is None


def test_files_and_plots_are_written(tmp_path):
    results = (
        BenchResult("cellcal", "all", 100, 0.01, 1e-6, "mm"),
        BenchResult("other", "all", 10, 0.01, 1e-3, "mm"),
    )
    topic = BenchTopic("compensate", "why", results)
    written = write_results(as_document((topic,), 0, 1), (topic,), tmp_path / "new")
    assert {path.name for path in written} == {
        "bench.json",
        "bench_compensate.png",
        "bench_compensate.svg",
    }
    assert all(path.stat().st_size > 300 for path in written)
    assert topic.speed_ratio(results[1]) == pytest.approx(10.0)


def test_whole_times_are_compared_where_a_topic_says_so():
    results = (
        BenchResult("cellcal", "all", 100, 0.01, 0, "mm"),
        BenchResult("other", "all", 100, 0.05, 0, "mm"),
    )
    assert BenchTopic("identify", "why", results, per_pose=False).speed_ratio(results[1]) == pytest.approx(
        5.0
    )


def test_turns_keep_the_best_time_and_do_not_ask_the_missing_again():
    called_names = []
    times = iter([0.3, 0.1, 0.2])

    def run_one(each):
        called_names.append(each.name)
        return AbsentContestant(each, "gone") if each is ABSENT else {}

    def judge_one(each, answers):
        return BenchResult(each.name, "all", 1, next(times), 0.0, "mm")

    results, absent = take_turns((OURS, ABSENT), 3, run_one, judge_one)
    assert [result.seconds for result in results] == [0.1]
    assert [each.contestant for each in absent] == [ABSENT]
    assert called_names.count("absent_peer") == 1


def test_the_determinant_root_is_that_of_the_sum():
    blocks = np.random.default_rng(0).normal(size=(4, 3, 6))
    chosen = np.array([0, 2, 5])
    total = sum(blocks[:, :, i] @ blocks[:, :, i].T for i in chosen)
    assert determinant_root(blocks, chosen) == pytest.approx(np.linalg.det(total) ** 0.25)
    assert determinant_root(blocks[:, :, :1] * 0, np.array([0])) == 0.0


def test_accuracy_is_that_of_many_draws_and_near_the_bound():
    case = identify.case_of(0, 100)
    result = BenchResult("cellcal", "100 rows", 100, 0.01, 0.02, "mm rms")
    often = {**case.often, "draws": np.array(60)}
    accuracy = identify.over_many_draws(result, replace(case, often=often))
    # Sixty draws of 27 unknowns leave 2 % to chance.
    assert accuracy.notes["over_cramer_rao_60_draws"] == pytest.approx(1.0, abs=0.08)


def test_the_shipped_measurements_are_those_of_the_published_files():
    published = Path(__file__).parents[1] / "data" / "ipa_ur10"
    names = ("series_b_joint_configurations.csv", "series_c_random_poses_first_1400.csv")
    for measured, name in zip(real.load_shipped(), names, strict=True):
        again = real.read_series(published / name, "ur10")
        assert measured.joints_rad == pytest.approx(again.joints_rad, abs=1e-12)
        assert measured.positions_m == pytest.approx(again.positions_m, abs=1e-12)


def test_rows_are_fitted_or_held_out_never_both():
    train, held_out = real.split_rows(1400, 3)
    assert len(train) == 600
    assert sorted([*train, *held_out]) == list(range(1400))
    assert len(real.split_rows(100, 3)[0]) == 60
    assert (real.split_rows(1400, 4)[0] != train).any()


def measured_arm(count):
    both = draw_arms(0)
    joints = draw_joints(np.random.default_rng(5), count)
    places = both.real.tip_positions(joints, np.array([0.08, -0.05, 0.12])) + np.array([0.5, -0.2, 0.3])
    return real.MeasuredSeries("simulated", both.nominal, joints, places)


def test_an_answer_of_the_wrong_shape_has_no_error_worth_a_number():
    answers = {"check_positions": np.zeros((2, 3)), "seconds": np.array(1.0)}
    result = real.judge_predictions(OURS, answers, np.zeros((5, 3)), "case", 10)
    assert result.error == float("inf")


def test_unusable_measurements_are_refused(tmp_path):
    path = tmp_path / "wire.csv"
    rows = [
        ",".join(f"{value:.3f}" for value in row) for row in np.random.default_rng(0).uniform(0, 90, (70, 7))
    ]
    path.write_text("\n".join(["q1,q2,q3,q4,q5,q6,L", *rows]) + "\n", encoding="utf-8")
    with pytest.raises(BenchError, match="lengths"):
        real.read_series(path, "ur10")
    with pytest.raises(BenchError, match="robot"):
        real.read_series(path, "")


def test_the_command_compares_on_a_file_where_geometry_beats_base_and_tool_only(tmp_path, capsys):
    measured = measured_arm(70)
    table = np.concatenate([np.rad2deg(measured.joints_rad), measured.positions_m * 1e3], axis=1)
    lines = ["q1,q2,q3,q4,q5,q6,x,y,z", *(",".join(f"{value:.6f}" for value in row) for row in table)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    arguments = ["bench", "--only", "real", "--rounds", "1", "--data", str(path), "--robot", "ur10", "--json"]
    for peer in PEERS:
        arguments += ["--peer-python", f"{peer.name}=/bin/false"]
    assert run_command_line([*arguments, "--out", str(tmp_path / "out")]) == 0
    document = json.loads(capsys.readouterr().out)
    (topic,) = document["topics"]
    assert {row["case"] for row in topic["results"]} == {"points.csv"}
    by_name = {row["contestant"]: row for row in topic["results"]}
    assert by_name["cellcal"]["error"] < 2e-3 < by_name["base and tool only"]["error"]
    assert by_name["cellcal, level chosen"]["notes"]["level"] >= 2
    assert by_name["cellcal"]["notes"]["held_out_rows"] == 28
    absent = {each["contestant"] for each in topic["absent"]}
    assert {"pinocchio", "figaroh", "pybotics"} <= absent
    assert set(by_name) | absent == {each.name for each in real.CONTESTANTS}
    assert all(each["reason"] for each in topic["absent"])
    assert json.loads((tmp_path / "out" / "bench.json").read_text(encoding="utf-8")) == document
    assert (tmp_path / "out" / "bench_real.svg").stat().st_size > 1000


def test_words_on_the_command_line():
    assert list(choose_topics("")) == list(TOPICS)
    assert list(choose_topics("poses, compensate")) == ["compensate", "poses"]
    assert parse_interpreters((f"pybotics={sys.executable}",)) == {"pybotics": Path(sys.executable)}
    for wrong in ("swim",):
        with pytest.raises(BenchError):
            choose_topics(wrong)
    for wrong in ("pybotics", "absent_peer=/bin/sh", "pybotics=/nowhere/python"):
        with pytest.raises(BenchError):
            parse_interpreters((wrong,))
