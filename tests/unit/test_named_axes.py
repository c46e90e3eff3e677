"""Settings that count axes take them by the names of the pendant; what is no axis of the robot is refused with them."""

from dataclasses import fields
from pathlib import Path

import pytest

from cellcal.calibration.errors import CellError
from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.service.cli.run_arguments import settings_of
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.runs.named_axes import with_numbered_axes
from cellcal.service.runs.settings import build_spec, spec_of
from cellcal.service.runs.settings_description import schema_of
from cellcal.service.runs.settings_description import settings_of as describe_settings

YASKAWA = tuple("SLURBT")
KUKA = ("A1", "A2", "A3", "A4", "A5", "A6")
FANUC = ("J1", "J2", "J3", "J4", "J5", "J6")


@pytest.mark.parametrize(
    ("names", "text", "numbers"),
    [
        (YASKAWA, "L", [2]),
        (YASKAWA, "s,b", [1, 5]),
        (YASKAWA, "U T", [3, 6]),
        (YASKAWA, '["S","L"]', [1, 2]),
        (YASKAWA, "3", [3]),
        (YASKAWA, "[2, 3]", [2, 3]),
        (KUKA, "A2, A3", [2, 3]),
        (KUKA, "a6", [6]),
        (KUKA, "[A1,A4]", [1, 4]),
        (KUKA, "2,3", [2, 3]),
        (FANUC, "J5", [5]),
        (FANUC, "[]", []),
    ],
)
def test_an_axis_is_taken_as_the_pendant_names_it_or_by_its_number(
    names: tuple[str, ...], text: str, numbers: list[int]
) -> None:
    settings = with_numbered_axes("position_cure", settings_of((f"axes_again={text}",)), names)
    assert settings == {"axes_again": numbers}
    assert spec_of("position_cure", settings).axes_again == tuple(numbers)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (YASKAWA, "A2"),
        (YASKAWA, "7"),
        (YASKAWA, "SL"),
        (YASKAWA, "0"),
        (KUKA, "S"),
        (KUKA, "A7"),
        (KUKA, "-1"),
    ],
)
def test_an_axis_of_another_make_is_refused_with_the_names_of_this_one(
    names: tuple[str, ...], text: str
) -> None:
    settings = settings_of((f"axes_again={text}",))
    with pytest.raises(CellError) as caught:
        with_numbered_axes("position_cure", settings, names)
    assert f"Axes to bring back again (axes_again): this robot has no axis {text}." in caught.value.message
    assert caught.value.remedy == f"Its axes are {', '.join(names)}."


def test_what_is_no_list_of_axes_is_left_to_the_check_of_the_setting() -> None:
    for odd in (1.5, [True], {"S": 1}, [[1]]):
        assert with_numbered_axes("position_cure", {"axes_again": odd}, YASKAWA) == {"axes_again": odd}
        with pytest.raises(CellError):
            spec_of("position_cure", {"axes_again": odd})


def test_every_setting_that_counts_axes_is_marked(tmp_path: Path) -> None:
    by_name = {
        (entry.name, field.name)
        for entry in DEFINITIONS
        for field in fields(entry.spec_type)
        if field.name.endswith(("axes", "axes_again"))
    }
    by_schema = {
        (entry.name, name)
        for entry in DEFINITIONS
        for name, shape in schema_of(entry.name, {})["properties"].items()
        if shape.get("x-axes")
    }
    assert by_schema == by_name
    assert {procedure for procedure, _ in by_schema} == {"mastering_recovery", "position_cure"}
    (entry,) = (each for each in describe_settings("position_cure") if each.name == "axes_again")
    assert "as the pendant names them" in entry.takes
    config = read_cell_file(write_cell_file(tmp_path, "127.0.0.9", seed=3, time_factor=50.0))
    spec = build_spec(config, "fanuc", "mastering_recovery", {"exchanged_axes": "J2, J3"})
    assert spec.exchanged_axes == (2, 3)
