"""Gear errors are a level of their own; any subset of parameters may be free, from nominal or from before."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.arm.joint_terms import JointTerm, gear_terms, term_values
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.identification.free_parameters import KnownPlaces, StartingPoint
from cellcal.calibration.identification.identify import identify_arm
from cellcal.calibration.identification.parameters import FRAMES, GEAR, OFFSETS
from cellcal.calibration.identification.selection import IdentificationOptions, terms_of_level
from tests.unit.helpers.simulated_arm import TRACKER, random_joints, tracker_points


def with_terms(simulated, terms, coefficients, sigma_m=5e-5):
    """The same arm with joint terms, measured anew."""
    state = replace(simulated.truth, terms=terms, coefficients=np.array(coefficients))
    joints = simulated.observations.joints_rad
    moved = state.moved_joints(joints, term_values(simulated.model, joints, terms))
    tips = state.seen_from(0).base_flange(moved)[:, :3, 3]
    measured_m = tips + sigma_m * np.random.default_rng(77).standard_normal(tips.shape)
    return replace(
        simulated, observations=replace(simulated.observations, positions_m=measured_m), truth=state
    )


def value_and_sigma(found, name):
    names = [p.name for p in found.robust.fit.layout.parameters]
    at = names.index(name)
    return found.robust.fit.deviations[at], np.sqrt(found.robust.fit.covariance[at, at])


def test_gear_terms_are_ratios_and_the_couplings_that_arms_have():
    names = {term.name for term in gear_terms(load_model("ur10"))}
    assert names == {
        *(f"J{i} gear ratio" for i in range(1, 7)),
        "J3 coupling to J2",
        "J5 coupling to J4",
        "J6 coupling to J4",
        "J6 coupling to J5",
    }


def test_a_gear_ratio_is_found_where_unseen_rows_show_it():
    terms = (JointTerm("gear", 2, source=2), JointTerm("gear", 4, source=3))
    simulated = with_terms(tracker_points(count=250), terms, [4e-4, -3e-4])
    found = identify_arm(simulated.model, simulated.observations, options=IdentificationOptions(judge=False))
    assert found.level == GEAR
    for name, truth in (("J3 gear ratio", 4e-4), ("J5 coupling to J4", -3e-4)):
        found_value, sigma = value_and_sigma(found, name)
        assert abs(found_value - truth) < 4 * sigma


def test_a_gear_ratio_is_not_asked_of_a_joint_with_few_angles():
    model = load_model("ur10")
    joints = random_joints(model, np.random.default_rng(0), 200)
    joints[:, 3] = np.round(joints[:, 3] * 2) / 2
    gear_names = {t.name for t in terms_of_level(model, joints, GEAR) if t.kind == "gear"}
    assert "J4 gear ratio" not in gear_names
    assert "J5 coupling to J4" not in gear_names
    assert "J6 coupling to J5" in gear_names


def test_waves_are_not_read_into_few_angles():
    model = load_model("ur10")
    # Each of 30 angles five times: fewer than 150 rows would not try more than two waves a turn.
    joints = np.tile(random_joints(model, np.random.default_rng(0), 30), (5, 1))
    orders = {t.order for t in terms_of_level(model, joints, GEAR) if t.kind == "harmonic"}
    assert orders == set(range(1, 7))


def prior_with_free_j2(simulated):
    """Everything as it is, but for what happens to J2 afterwards."""
    found = identify_arm(
        simulated.model, simulated.observations, options=IdentificationOptions(level=2, judge=False)
    )
    names = [p.name for p in found.robust.fit.layout.parameters]
    values = dict(zip(names, found.robust.fit.deviations, strict=True))
    arm = {n: v for n, v in values.items() if not n.startswith(("base", "tool"))}
    return arm, KnownPlaces(found.state.devices[0], found.state.flange_tool)


@pytest.fixture(scope="module")
def earlier_fit():
    simulated = tracker_points(count=150)
    return simulated, *prior_with_free_j2(simulated)


def slipped_rows(simulated, count, slip_rad):
    joints = random_joints(simulated.model, np.random.default_rng(3), count)
    moved = joints.copy()
    moved[:, 1] += slip_rad
    tips = simulated.truth.seen_from(0).base_flange(moved)[:, :3, 3]
    measured_m = tips + 5e-5 * np.random.default_rng(4).standard_normal(tips.shape)
    rows = tracker_points(count=count, joints=joints).observations
    return replace(rows, positions_m=measured_m)


def test_one_offset_is_found_again_from_four_rows(earlier_fit):
    simulated, arm, places = earlier_fit
    start = StartingPoint(arm, ("J2 offset",), places)
    rows = slipped_rows(simulated, 4, 2e-3)
    found = identify_arm(simulated.model, rows, options=IdentificationOptions(start=start))
    assert found.level == OFFSETS
    assert [p.name for p in found.robust.fit.layout.parameters] == ["J2 offset"]
    assert found.state.geometry[1, 0] - arm["J2 offset"] == pytest.approx(2e-3, abs=2e-4)
    assert found.before_errors.rmse_m > 5 * found.held_out.rmse_m


def test_what_is_held_stays_exactly_where_it_was(earlier_fit):
    simulated, arm, places = earlier_fit
    start = StartingPoint(arm, ("offsets", "tool"), places)
    found = identify_arm(
        simulated.model,
        slipped_rows(simulated, 30, 1e-3),
        options=IdentificationOptions(start=start, judge=False),
    )
    roles = {p.role for p in found.robust.fit.layout.parameters}
    assert roles == {"offset", "tool"}
    expected = [arm[f"J{i} {name}"] for i in range(1, 7) for name in ("d", "a", "alpha", "beta")]
    assert found.state.geometry[:, 1:].ravel().tolist() == expected
    assert (found.state.devices[0].device_base == places.device.device_base).all()
    assert not np.allclose(found.state.flange_tool, places.flange_tool, atol=1e-12)


def test_priors_stand_around_what_was_known_before(earlier_fit):
    simulated, arm, _ = earlier_fit
    start = StartingPoint({**arm, "J1 d": 7e-4})
    found = identify_arm(
        simulated.model,
        simulated.observations,
        options=IdentificationOptions(level=2, judge=False, start=start),
    )
    # The base hides it: what was known before is all that there is.
    assert found.state.geometry[0, 1] == pytest.approx(7e-4, abs=5e-5)


def test_an_arm_that_is_still_as_before_is_left_so(earlier_fit):
    simulated, arm, _ = earlier_fit
    again = tracker_points(count=40, seed=1).observations
    found = identify_arm(
        simulated.model, again, options=IdentificationOptions(start=StartingPoint(arm), judge=False)
    )
    assert found.level == FRAMES
    assert found.state.geometry[1, 0] == arm["J2 offset"]


def test_unknown_base_and_tool_are_free(earlier_fit):
    simulated, arm, _ = earlier_fit
    start = StartingPoint(arm, ("J3",))
    found = identify_arm(
        simulated.model,
        slipped_rows(simulated, 12, 0.0),
        options=IdentificationOptions(start=start, judge=False),
    )
    roles = {p.role for p in found.robust.fit.layout.parameters}
    assert roles == {"base", "tool", "offset", "geometry"}
    assert {p.joint for p in found.robust.fit.layout.parameters} == {-1, 2}
    assert np.abs(found.state.devices[0].device_base[:3, 3] - TRACKER[:3, 3]).max() < 0.01


def test_a_name_that_does_not_exist_is_answered_with_those_that_do(earlier_fit):
    simulated, *_ = earlier_fit
    with pytest.raises(CalibrationError) as caught:
        identify_arm(
            simulated.model,
            simulated.observations,
            options=IdentificationOptions(start=StartingPoint(free=("j2 OFSET",))),
        )
    assert caught.value.code == "usage"
    assert "J2 offset" in caught.value.remedy
    assert "gravity" in caught.value.remedy


def test_fewer_rows_than_what_is_free_are_refused(earlier_fit):
    simulated, arm, places = earlier_fit
    start = StartingPoint(arm, ("geometry",), places)
    with pytest.raises(DegenerateDataError):
        identify_arm(
            simulated.model, slipped_rows(simulated, 6, 0.0), options=IdentificationOptions(start=start)
        )
