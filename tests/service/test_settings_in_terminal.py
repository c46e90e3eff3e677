"""What the terminal says of a procedure's settings is what a run takes."""

import json

import pytest

from cellcal.procedures.catalogue import CATALOGUE
from cellcal.service.cli.app import run_command_line as main
from cellcal.service.runs.settings_description import settings_of


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_every_setting_is_reported_and_those_without_a_default_first(name: str) -> None:
    settings = settings_of(name)
    assert {each.name for each in settings} == set(CATALOGUE[name].spec_type.__dataclass_fields__)
    assert all(each.takes for each in settings)
    needed = [each.default is None for each in settings]
    assert needed == sorted(needed, reverse=True)


def test_words_of_types_and_bounds() -> None:
    settings = {each.name: each for each in settings_of("fixture_alignment")}
    assert settings["rough_sigma_m"].takes == "number above 0 to 0.2"
    assert settings["points_in_fixture_m"].takes == "[[3 x number], …, 3 to 12 of them]"
    assert settings["rough_base_fixture"].takes == "{position_m, quaternion}"
    assert settings["rough_base_fixture"].default is None
    assert settings["bases"].takes == "{origin_m, angle_rad} or null"


def test_a_default_that_is_shown_can_be_typed_back() -> None:
    settings = {each.name: each for each in settings_of("mastering_recovery")}
    assert json.loads(settings["accuracy_class"].default or "") == "B"
    assert settings["accuracy_class"].takes == "A, B, C"


def test_the_terminal_shows_them_and_refuses_what_it_does_not_know(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["procedures", "six_point_tcp", "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert [each["name"] for each in output["settings"] if each["default"] is None] == ["tool_number"]
    assert main(["procedures", "six_point_tpc"]) != 0
    assert "six_point_tcp" in capsys.readouterr().err
