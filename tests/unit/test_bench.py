"""Benchmarks: who is missing is named, claims are judged apart, and nothing but numbers is written."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from service.bench.compensate import judge
from service.bench.contestants import (
    OURS,
    PEERS,
    Absent,
    BenchError,
    Contestant,
    parse_interpreters,
    run,
)
from service.bench.plots import write_results
from service.bench.poses import determinant_root
from service.bench.results import Result, Topic, as_document, take_turns
from service.bench.simulated import arms, draw_joints
from service.bench.topics import TOPICS, choose_topics

NOBODY = Contestant("nobody", "roboticstoolbox_peer.py", "roboticstoolbox-python==1.5.0")


def small_inputs(count=50):
    both = arms(0)
    joints = draw_joints(np.random.default_rng(1), count) * 0.5
    return both, {**both.inputs(), "joints": joints}


def test_ours_runs_in_its_own_process_and_is_right():
    both, inputs = small_inputs()
    answers = run(OURS, "compensate", inputs, {})
    result = judge(OURS, both, inputs["joints"], answers)
    assert result.count == 50
    assert result.error < 1e-5
    assert result.notes["claimed_but_above_1e-5_mm"] == 0
    assert result.notes["solved_share"] > 0.9


def test_a_peer_that_is_not_installed_is_named_with_its_cure(tmp_path):
    program = tmp_path / "peer.py"
    program.write_text("def compensate(inputs, measure):\n    import a_peer_of_nobody\n", encoding="utf-8")
    nobody = Contestant("nobody", str(program), "a-peer-of-nobody==1.0")
    _, inputs = small_inputs(3)
    answer = run(nobody, "compensate", inputs, {})
    assert isinstance(answer, Absent)
    assert "not installed: a_peer_of_nobody (a-peer-of-nobody==1.0" in answer.reason
    assert "--peer-python nobody=" in answer.reason


def test_a_peer_that_breaks_is_named_too():
    answer = run(OURS, "compensate", {"joints": np.zeros((2, 6))}, {})
    assert isinstance(answer, Absent)
    assert answer.reason.startswith("failed: KeyError")


def test_false_claims_and_leaps_are_counted():
    both, inputs = small_inputs(4)
    joints = inputs["joints"]
    found = joints.copy()
    found[1, 0] += 2 * np.pi
    answers = {"joints": found, "claimed": np.array([1, 1, 1, 0]), "seconds": np.array(1.0)}
    result = judge(PEERS[0], both, joints, answers)
    assert result.notes["leaps"] == 1
    assert result.notes["claimed_but_above_1e-5_mm"] == 3
    assert result.notes["solved_share"] == 0.75
    assert result.error > 0.1


def test_nothing_solved_can_still_be_written(tmp_path):
    both, inputs = small_inputs(2)
    answers = {"joints": inputs["joints"], "claimed": np.zeros(2), "seconds": np.array(1.0)}
    lost = judge(PEERS[0], both, inputs["joints"], answers)
    topic = Topic("compensate", "why", (lost,), (Absent(NOBODY, "not installed"),))
    document = as_document((topic,), 0, 1)
    row = json.loads(json.dumps(document, allow_nan=False))["topics"][0]["results"][0]
    assert row["error"] is None
    assert row["times_slower_than_cellcal"] is None


def test_files_and_plots_are_written(tmp_path):
    results = (Result("cellcal", "all", 100, 0.01, 1e-6, "mm"), Result("other", "all", 10, 0.01, 1e-3, "mm"))
    topic = Topic("compensate", "why", results)
    written = write_results(as_document((topic,), 0, 1), (topic,), tmp_path / "new")
    assert {path.name for path in written} == {
        "bench.json",
        "bench_compensate.png",
        "bench_compensate.svg",
    }
    assert all(path.stat().st_size > 300 for path in written)
    assert topic.ratio(results[1]) == pytest.approx(10.0)


def test_whole_times_are_compared_where_a_topic_says_so():
    results = (Result("cellcal", "all", 100, 0.01, 0, "mm"), Result("other", "all", 100, 0.05, 0, "mm"))
    assert Topic("identify", "why", results, per_pose=False).ratio(results[1]) == pytest.approx(5.0)


def test_turns_keep_the_best_time_and_do_not_ask_the_missing_again():
    asked = []
    times = iter([0.3, 0.1, 0.2])

    def run_one(each):
        asked.append(each.name)
        return Absent(each, "gone") if each is NOBODY else {}

    def judge_one(each, answers):
        return Result(each.name, "all", 1, next(times), 0.0, "mm")

    results, absent = take_turns((OURS, NOBODY), 3, run_one, judge_one)
    assert [result.seconds for result in results] == [0.1]
    assert [each.contestant for each in absent] == [NOBODY]
    assert asked.count("nobody") == 1


def test_the_determinant_root_is_that_of_the_sum():
    blocks = np.random.default_rng(0).normal(size=(4, 3, 6))
    chosen = np.array([0, 2, 5])
    total = sum(blocks[:, :, i] @ blocks[:, :, i].T for i in chosen)
    assert determinant_root(blocks, chosen) == pytest.approx(np.linalg.det(total) ** 0.25)
    assert determinant_root(blocks[:, :, :1] * 0, np.array([0])) == 0.0


def test_words_on_the_command_line():
    assert list(choose_topics("")) == list(TOPICS)
    assert list(choose_topics("poses, compensate")) == ["compensate", "poses"]
    assert parse_interpreters((f"pybotics={sys.executable}",)) == {"pybotics": Path(sys.executable)}
    for wrong in ("swim",):
        with pytest.raises(BenchError):
            choose_topics(wrong)
    for wrong in ("pybotics", "nobody=/bin/sh", "pybotics=/nowhere/python"):
        with pytest.raises(BenchError):
            parse_interpreters((wrong,))
