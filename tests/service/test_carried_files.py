"""Files in settings: a page carries them; it reads no file of the service's computer."""

import base64
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.errors import CellError
from cellcal.procedures.simulation_cell import SimulationCell
from cellcal.service.configuration.file_settings import file_settings
from cellcal.service.engineering.parameters.simulated_cells import refuse_paths
from cellcal.service.runs.settings import spec_of
from tests.service.cell_process_session import open_session

TAGS = "tag,x,y,z\nP1,0.1,0.2,0.3\nP2,0.5,0.2,0.3\nP3,0.1,0.9,0.3\n"


def file_setting(name: str = "robot.csv", text: str = TAGS) -> dict[str, Any]:
    """Return a file as a page sends it."""
    return {"name": name, "content_base64": base64.b64encode(text.encode()).decode()}


def test_a_carried_file_is_read_as_one_that_is_named(tmp_path: Path) -> None:
    (tmp_path / "robot.csv").write_text(TAGS, encoding="utf-8")
    named = {
        "part": "base",
        "simulated": str(tmp_path / "robot.csv"),
        "measured": file_setting("fixture.csv"),
    }
    spec = spec_of("simulation_cell", named)
    assert spec == spec_of("simulation_cell", named | {"simulated": {"file": file_setting()}})
    assert spec.simulated.positions_m == spec.measured.positions_m
    assert (spec.simulated.source, spec.measured.source) == ("robot.csv", "fixture.csv")


def test_a_file_is_read_by_the_settings_of_the_form() -> None:
    strange = "who,e,n,h,r1,r2,r3,j\nP1,10,20,30,90,0,0,1\nP2,50,20,30,0,90,0,2\nP3,10,90,30,0,0,90,3\n"
    form_settings = {
        "units": {"position": "cm", "rotation": "deg"},
        "columns": {"name": "who", "position": "e, n, h", "rotation": "r1, r2,r3"},
        "convention": "fanuc_wpr",
    }
    named = {
        "part": "base",
        "simulated": {"file": file_setting(text=strange), **form_settings},
        "measured": file_setting(),
    }
    path = spec_of("simulation_cell", named).simulated
    assert path.names == ("P1", "P2", "P3")
    assert (
        path.positions_m
        == spec_of("simulation_cell", named | {"simulated": file_setting()}).measured.positions_m
    )
    half = pytest.approx(0.5**0.5)
    assert tuple(map(abs, path.quaternions[0])) == (
        half,
        half,
        pytest.approx(0),
        pytest.approx(0),
    )


@pytest.mark.parametrize(
    "file",
    [
        {"name": "..", "content_base64": ""},
        {"name": "a/../.bashrc", "content_base64": ""},
        {"name": 7, "content_base64": ""},
        {"name": "tags.csv", "content_base64": "no base64!"},
        {"name": "tags.csv", "content_base64": None},
        {"name": "tags.csv", "content_base64": base64.b64encode(b"\xff\xfe\x00").decode()},
    ],
)
def test_what_is_no_file_is_refused_in_words(file: dict[str, Any]) -> None:
    with pytest.raises(CellError) as refused:
        spec_of("simulation_cell", {"part": "base", "simulated": file, "measured": file_setting()})
    assert refused.value.remedy


def test_the_files_of_a_procedure_are_known_and_a_path_from_a_screen_is_refused() -> None:
    assert set(file_settings(SimulationCell)) == {"simulated", "measured", "description"}
    refuse_paths(
        SimulationCell, {"simulated": file_setting(), "measured": {"file": file_setting()}, "description": ""}
    )
    for path in ("/etc/passwd", {"file": "/etc/passwd"}, {"file": "/etc/passwd", "columns": {}}):
        with pytest.raises(CellError, match="file of the service's computer"):
            refuse_paths(SimulationCell, {"simulated": file_setting(), "measured": path})


async def test_a_screen_cannot_make_the_cell_process_read_a_file(tmp_path: Path) -> None:
    async with open_session(tmp_path) as person:
        settings = {"part": "base", "simulated": "/etc/passwd", "measured": file_setting()}
        answer = await person.send_order(
            {"op": "start", "procedure": "simulation_cell", "settings": settings}
        )
        assert "file of the service's computer" in str(answer)
        assert person.session["run"] is None
