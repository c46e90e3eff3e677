"""A slice of the gate's campaign, and that its judge would notice."""

from tests.soak import motion_gate
from tests.soak.gate_oracle import MoveOracle

CAP_M_S = 0.25


def test_no_random_target_escapes() -> None:
    figures = motion_gate.gate(300)
    assert figures.reached, figures.line


def test_the_judge_complains_about_each_kind_of_bad_move() -> None:
    home = motion_gate.HOME
    judge = MoveOracle(motion_gate.MODEL, motion_gate.KNOWN, motion_gate.AT, 3.0)
    assert judge.find_complaints(home, (0.25, *home[1:]), 0.1, CAP_M_S) == []
    assert judge.find_complaints(home, (float("nan"), *home[1:]), 0.1, CAP_M_S) == ["not finite"]
    assert "limits" in judge.find_complaints(home, (9.0, *home[1:]), 0.1, CAP_M_S)
    assert "speed" in judge.find_complaints(home, (0.4, *home[1:]), 1.0, CAP_M_S)
    assert "contact" in judge.find_complaints(home, (0.5, 1.5, -0.8, *home[3:]), 0.1, CAP_M_S)
    behind = (2.5, 0.6, -0.6, *home[3:])
    assert {"wire length", "wire"} & set(judge.find_complaints(home, behind, 0.1, CAP_M_S))
