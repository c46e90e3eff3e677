"""Parameter sets: text that comes back bit for bit, versions that follow each other, and ways back."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.arm.ur_factory import factory_model
from cellcal.service.cli.parameters import list_sets
from cellcal.service.engineering.parameters.calibrated_models import (
    calibrated_model,
    nominal_sha256,
    values_of_identification,
    values_of_model,
)
from cellcal.service.engineering.parameters.identified_parameter import IdentifiedParameter
from cellcal.service.engineering.parameters.parameter_sets import (
    ParameterSet,
    ParameterSetError,
    ParameterSets,
    ParameterValue,
    compare_sets,
    parse_set,
    to_text,
)
from tests.unit.test_ur_factory import ABSOLUTE

UR = load_model("ur10e")
JOINTS = np.random.default_rng(0).uniform(-3, 3, (50, 6))


ONE = (ParameterValue("J2 offset", "rad", 1.25e-4, 3e-6),)


def draft_set(values=ONE, **changes):
    fields = {
        "robot_serial": "2022-17",
        "model": "ur10e",
        "nominal_sha256": nominal_sha256(UR),
        "made_at": "2026-11-21T06:00:00+00:00",
        "made_by": "Ada",
        "source": "measurements.csv",
    }
    return ParameterSet(values=tuple(values), **{**fields, **changes})


finite = st.floats(allow_nan=False, allow_infinity=False)
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
values = st.builds(
    ParameterValue,
    words,
    st.sampled_from(["rad", "m", "rad/m", "1"]),
    finite,
    st.none() | st.floats(min_value=0, allow_nan=False, allow_infinity=False),
    determined=st.booleans(),
)


@given(st.lists(values, min_size=1, max_size=4, unique_by=lambda v: v.name), words, words)
def test_what_is_written_comes_back_bit_for_bit(some, who, why):
    item = draft_set(some, made_by=who, note=why, version=3, rolls_back_to=1)
    assert parse_set(to_text(item)) == item


def test_units_stand_in_the_names():
    text = to_text(
        draft_set(
            [ParameterValue("J2 sag under link 2", "rad/m", 1e-5), ParameterValue("J3 a", "m", -2e-4, 1e-5)]
        )
    )
    assert "value_rad_per_m = 1e-05" in text
    assert "value_m = -0.0002" in text
    assert "standard_uncertainty_m = 1e-05" in text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("value_rad = 0.000125", "value_rad = 0.000126", "hash"),
        ('made_by = "Ada"', 'made_by = "Eve"', "hash"),
        ('made_by = "Ada"\n', "", "missing"),
        ("format = 1", "format = 2", "format"),
        ("value_rad", "value_deg", "one unit"),
        ("value_rad = 0.000125", "value_rad = nan", "finite"),
        ("value_rad = 0.000125", 'value_rad = "1"', "one unit"),
        ("[[parameter]]", "[[parameters]]", "missing"),
        ("version = 1", "version = true", "wrong kind"),
        ("version = 1", "version = [", "not a parameter set"),
    ],
)
def test_a_file_that_was_touched_is_refused(old, new, words):
    text = to_text(draft_set(version=1))
    changed = text.replace(old, new, 1)
    assert changed != text
    with pytest.raises(ParameterSetError, match=words):
        parse_set(changed)


def test_versions_follow_each_other(tmp_path):
    sets = ParameterSets(tmp_path)
    first = sets.save_draft(draft_set())
    second = sets.save_draft(draft_set([ParameterValue("J2 offset", "rad", 2e-4, 4e-6)]))
    assert (first.version, second.version) == (1, 2)
    assert second.previous_sha256 == first.sha256
    assert sets.load_history("2022-17") == (first, second)
    assert sets.load_set("2022-17") == second
    assert sets.load_set("2022-17", 1) == first
    assert sets.robot_serials() == ("2022-17",)


def test_going_back_is_a_new_version_that_names_the_old_one(tmp_path):
    sets = ParameterSets(tmp_path)
    first = sets.save_draft(draft_set())
    sets.save_draft(draft_set([ParameterValue("J2 offset", "rad", 9e-4)]))
    back = sets.roll_back(
        "2022-17", 1, made_by="Grace", made_at="2026-12-01T00:00:00+00:00", note="worse in check"
    )
    assert back.version == 3
    assert back.rolls_back_to == 1
    assert back.values == first.values
    assert back.made_by == "Grace"
    assert len(sets.load_history("2022-17")) == 3


def test_a_missing_or_foreign_version_breaks_the_chain(tmp_path):
    sets = ParameterSets(tmp_path)
    for size in (1e-4, 2e-4, 3e-4):
        sets.save_draft(draft_set([ParameterValue("J2 offset", "rad", size)]))
    folder = tmp_path / "2022-17"
    version_text = (folder / "v0002.toml").read_text()
    (folder / "v0002.toml").unlink()
    with pytest.raises(ParameterSetError, match="missing"):
        sets.load_set("2022-17")
    foreign = draft_set([ParameterValue("J2 offset", "rad", 7e-4)], version=2)
    (folder / "v0002.toml").write_text(to_text(foreign))
    with pytest.raises(ParameterSetError, match="does not follow"):
        sets.load_set("2022-17")
    (folder / "v0002.toml").write_text(version_text)
    assert len(sets.load_history("2022-17")) == 3


def test_a_version_written_concurrently_is_not_overwritten(tmp_path, monkeypatch):
    sets = ParameterSets(tmp_path)
    sets.save_draft(draft_set())
    theirs = draft_set([ParameterValue("J2 offset", "rad", 5e-4)])
    link = os.link

    def link_after_other(source, target):
        monkeypatch.setattr(os, "link", link)
        ParameterSets(tmp_path).save_draft(theirs)
        link(source, target)

    monkeypatch.setattr(os, "link", link_after_other)
    with pytest.raises(ParameterSetError, match="another process"):
        sets.save_draft(draft_set([ParameterValue("J2 offset", "rad", 6e-4)]))
    assert sets.load_set("2022-17").values == theirs.values
    assert {item.name for item in (tmp_path / "2022-17").iterdir()} == {"v0001.toml", "v0002.toml"}


@pytest.mark.parametrize("serial", ["", "..", "a/b", ".hidden", "x" * 65])
def test_a_serial_cannot_leave_the_folder(tmp_path, serial):
    with pytest.raises(ParameterSetError, match="cannot name a robot"):
        ParameterSets(tmp_path).save_draft(draft_set(robot_serial=serial))


def test_unknown_robots_and_versions_are_named(tmp_path):
    sets = ParameterSets(tmp_path / "none_yet")
    assert sets.robot_serials() == ()
    with pytest.raises(ParameterSetError, match="no parameter sets"):
        sets.load_set("17")
    sets.save_draft(draft_set())
    with pytest.raises(ParameterSetError, match="versions 1 to 1"):
        sets.load_set("2022-17", 2)


def test_a_difference_counts_in_standard_uncertainties():
    before = draft_set(
        [
            ParameterValue("J2 offset", "rad", 1e-4, 3e-6),
            ParameterValue("J3 offset", "rad", 1e-4),
            ParameterValue("J1 d", "m", 1e-4),
        ]
    )
    after = draft_set(
        [
            ParameterValue("J2 offset", "rad", 1.5e-4, 4e-6),
            ParameterValue("J3 offset", "rad", 2e-4),
            ParameterValue("J4 a", "m", 1e-5),
        ]
    )
    changes = {change.name: change for change in compare_sets(before, after)}
    assert changes["J2 offset"].difference_in_sigmas == pytest.approx(10.0)
    assert changes["J3 offset"].difference_in_sigmas is None
    assert changes["J1 d"].value_difference == -1e-4
    assert changes["J4 a"].value_difference == 1e-5
    assert compare_sets(before, before) == ()


def test_what_a_measurement_left_where_it_was_assumed_is_no_result():
    assumed, found = values_of_identification(
        [
            IdentifiedParameter("J1 offset", "rad", 0.0, 8.7e-3, 8.7e-3),
            IdentifiedParameter("J2 offset", "rad", 1e-3, 1e-5, 8.7e-3),
        ]
    )
    assert (assumed.determined, found.determined) == (False, True)
    text = to_text(draft_set([assumed, found]))
    assert text.count("determined = false") == 1
    assert parse_set(text).values == (assumed, found)
    with pytest.raises(ParameterSetError, match="hash"):
        parse_set(text.replace("determined = false\n", ""))
    with pytest.raises(ParameterSetError, match="one unit"):
        parse_set(text.replace("determined = false", "determined = 0"))
    (change,) = compare_sets(draft_set([replace(assumed, value=1e-3), found]), draft_set([assumed, found]))
    assert (change.is_determined, change.difference_in_sigmas) == (False, None)


def test_an_empty_set_and_a_value_that_is_none_are_refused():
    with pytest.raises(ParameterSetError):
        draft_set([])
    with pytest.raises(ParameterSetError):
        ParameterValue("J1 d", "mm", 1.0)
    with pytest.raises(ParameterSetError):
        ParameterValue("J1 d", "m", float("inf"))
    with pytest.raises(ParameterSetError):
        ParameterValue("J1 d", "m", 1.0, -1.0)


def test_a_factory_calibration_goes_through_a_set_unchanged():
    arm = factory_model(UR, ABSOLUTE)
    found = calibrated_model(UR, parse_set(to_text(draft_set(values_of_model(UR, arm)))))
    assert np.allclose(found.model.base_flange(JOINTS), arm.base_flange(JOINTS), rtol=0, atol=1e-13)
    assert found.left_out == ()


def test_a_rigid_model_says_what_it_cannot_hold():
    identified = [
        IdentifiedParameter("J2 offset", "rad", 1e-3, 1e-5, 1e-2),
        IdentifiedParameter("J2 sag under link 2", "rad/m", 1e-3, 1e-5, 1e-2),
    ]
    found = calibrated_model(UR, draft_set(values_of_identification(identified)))
    assert found.left_out == ("J2 sag under link 2",)
    moved = JOINTS + np.array([0, 1e-3, 0, 0, 0, 0])
    assert np.allclose(found.model.base_flange(JOINTS), UR.base_flange(moved), atol=1e-13)


def test_a_set_of_another_nominal_model_is_refused():
    item = draft_set()
    with pytest.raises(ParameterSetError, match="nominal"):
        calibrated_model(load_model("ur10"), item)
    with pytest.raises(ParameterSetError, match="nominal"):
        calibrated_model(UR, replace(item, nominal_sha256="0" * 64))


def test_a_folder_that_is_not_there_is_not_listed_as_an_empty_one(tmp_path: Path) -> None:
    with pytest.raises(ParameterSetError, match="there is no folder") as refusal:
        list_sets(folder=tmp_path / "nowhere")
    assert refusal.value.code == "usage"
    assert list_sets(folder=tmp_path) == 0
