"""What a person is asked before a mastering is written names what no measurement tells."""

import pytest

from cellcal.calibration.mastering.turn_results import TurnRecovery
from cellcal.procedures.recovery.recovery_result import correction_instruction


def found(mode: str, replaced: tuple[int, ...]) -> TurnRecovery:
    return TurnRecovery(
        mode=mode,
        accepted=True,
        reason="the reference of J2 is new, the others lost turns",
        turns=(3, -2, 5),
        replaced_axes=replaced,
        offset_turns=(3.0, -2.4, 5.0),
        offset_u_rad=(0.0, 2e-4, 0.0),
        counts_at_zero=(0, 0, 0),
        gate=(),
        poses_needed=0,
        next_joints_rad=(),
        suspect_capture=None,
        changed_part="",
        success_probability=1.0,
        sigma_turns=(0.004, 0.5, 0.012),
        chi_square=9.0,
        degrees_of_freedom=10,
        captures=16,
        offset_covariance=(),
        blind_turns=(0.02, 0.02, 0.05) if mode == "turns" else (),
    )


@pytest.mark.parametrize(
    ("mode", "replaced", "said"),
    [
        ("turns", (), "within 0.05 turn of a whole one looks the same"),
        (
            "motor",
            (1,),
            "other motors are exact only if no part of them was exchanged, too (a new one within 0.04",
        ),
        ("all", (0, 1, 2), None),
    ],
)
def test_a_motor_exchanged_near_a_whole_turn_is_named_as_unseen(
    mode: str, replaced: tuple[int, ...], said: str | None
) -> None:
    text = correction_instruction(found(mode, replaced)).text
    assert ("exchanged_axes" in text) == (said is not None)
    assert said is None or said in text
