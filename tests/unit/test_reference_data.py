"""Shipped reference problems: made again by an independent solver, met by ours, in any unit, world and order."""

import json

import numpy as np
import pytest

from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.reference_data import load_reference, reference_names
from cellcal.service.cli.app import run_command_line
from cellcal.service.engineering.bench import reference
from cellcal.service.engineering.bench.reference import FORMS, WORLD, check_all, check_problem
from cellcal.service.engineering.bench.reference_solvers import SOLVERS
from tests.unit.helpers import reference_solver


def numbers_in(value):
    return np.array(value, dtype=float)


def test_every_file_is_made_and_solved_and_no_other():
    assert set(reference_names()) == set(reference_solver.SOLVERS) == set(SOLVERS) == set(FORMS)
    with pytest.raises(CalibrationError, match="no reference data set"):
        load_reference("../robot_models/ur10")


@pytest.mark.parametrize("name", reference_names())
def test_the_independent_solver_makes_the_answers_again(name):
    document = load_reference(name)
    again = reference_solver.answer_problem(name, document["given"])
    assert again.keys() == document["answers"].keys()
    for key, value in again.items():
        # Beyond a double: decimals as they stand in the file.
        assert (
            value == document["answers"][key]
            or np.abs(numbers_in(value) - numbers_in(document["answers"][key])).max() < 1e-20
        )


@pytest.mark.parametrize("name", reference_names())
def test_our_solvers_meet_the_answers_in_any_unit_world_and_order(name):
    found = list(check_problem(load_reference(name), name))
    assert [each for each in found if not each.passed] == []
    assert {each.answer for each in found} == set(load_reference(name)["answers"])


def test_every_problem_is_posed_in_every_way_that_it_can_be():
    posed = {(each.problem, each.posed) for each in check_all()}
    names = set(reference_names())
    assert {name for name, how in posed if how == "as given"} == names
    assert {name for name, how in posed if how == "in millimetres"} == names
    # A chain and its joints have no world, lost turns neither.
    assert {name for name, how in posed if how == "in another world"} == names - {
        "dh",
        "compensation",
        "turn_loss",
    }
    # The points of a frame have each their own meaning.
    assert {name for name, how in posed if how == "in another order"} == names - {"frame"}


@pytest.mark.parametrize("name", reference_names())
def test_a_wrong_answer_fails(name):
    document = json.loads(json.dumps(load_reference(name)))
    key = next(iter(document["answers"]))
    spoilt = numbers_in(document["answers"][key])
    spoilt[(0,) * spoilt.ndim] += 3 * document["tolerance"] if spoilt.dtype.kind == "f" else 1
    document["answers"][key] = spoilt.tolist()
    assert not all(each.passed for each in check_problem(document, name) if each.answer == key)


def test_an_answer_that_is_no_number_fails(monkeypatch):
    monkeypatch.setitem(reference.SOLVERS, "dh", lambda inputs: {"flanges": np.full((3, 4, 4), np.nan)})
    assert not any(each.passed for each in check_problem(load_reference("dh"), "dh"))


def test_the_problems_are_worth_solving():
    inputs = load_reference("turn_loss")
    rounded = np.rint(numbers_in(inputs["answers"]["real_turns"]))
    assert (rounded != numbers_in(inputs["answers"]["turns"])).any(), "rounding is not enough"
    inputs = load_reference("compensation")
    moved = numbers_in(inputs["answers"]["joints_rad"]) - numbers_in(inputs["given"]["joints_rad"])
    assert np.abs(moved).max() > 1e-3
    for name, key in (
        ("plane", "rms_m"),
        ("fixture", "rms_m"),
        ("registration", "rms_m"),
        ("tool_point", "rms_m"),
    ):
        assert float(load_reference(name)["answers"][key]) > 1e-5, "data contradict each other a little"
    assert np.abs(WORLD[:3, :3] - np.eye(3)).max() > 0.5


def test_the_command_prints_every_comparison_and_says_how_it_ended(tmp_path, capsys):
    assert run_command_line(["bench", "--reference", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    written = json.loads((tmp_path / "reference.json").read_text(encoding="utf-8"))
    assert written["passed"] is True
    assert printed.count("pass") == len(written["comparisons"])
    assert f"{len(written['comparisons'])} comparisons, 0 failed." in printed


def test_the_command_fails_loudly(monkeypatch, capsys):
    def wrong_answers(inputs):
        return {"flanges": np.zeros((3, 4, 4))}

    monkeypatch.setitem(reference.SOLVERS, "dh", wrong_answers)
    assert run_command_line(["bench", "--reference", "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["passed"] is False
