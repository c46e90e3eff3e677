"""What this product must never be able to do to a Universal Robots arm does not occur in its source."""

import re
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[2]
_ROOMS = ("calibration", "drivers", "procedures", "service")
_BANNED = (
    "FLAG_DISABLE_REMOTE_CONTROL_CHECK",
    "unlock ?protective ?stop",
    "brake ?release",
    "power ?on",
    "power ?off",
    "set ?payload",
    "set ?target ?payload",
    "restart ?safety",
    "close ?safety ?popup",
    "reupload ?script",
    "reconnect",
    "set ?user ?role",
    "DashboardClient",
)
_UR_PACKAGE = _ROOT / "drivers" / "universal_robots"


def _code_of(path: Path) -> str:
    """Return a source without its comments and docstrings: those may name what is forbidden, to say so."""
    text = re.sub(r'"""(?:.|\n)*?"""', '""', path.read_text(encoding="utf-8"))
    return re.sub(r"#[^\n]*", "", text)


def _source_files() -> list[Path]:
    return [path for room in _ROOMS for path in (_ROOT / room).rglob("*.py")]


@pytest.mark.parametrize("banned", _BANNED)
def test_the_ur_driver_cannot_be_asked_for_what_only_a_person_may_do(banned: str) -> None:
    pattern = re.compile(banned.replace(" ?", "[ _]?"), re.IGNORECASE)
    # Readers of program files name what programs may call; they talk to no robot.
    speaking = [path for path in _UR_PACKAGE.rglob("*.py") if path.parent.name != "program_files"]
    guilty = [path.name for path in speaking if pattern.search(_code_of(path))]
    assert guilty == []


@pytest.mark.parametrize("library", ["rtde_control", "rtde_receive", "rtde_io", "dashboard_client"])
def test_only_the_child_imports_the_vendor_library(library: str) -> None:
    pattern = re.compile(rf"^\s*(?:import|from) {library}\b", re.MULTILINE)
    importers = [path for path in _source_files() if pattern.search(_code_of(path))]
    assert importers == ([_UR_PACKAGE / "child.py"] if library == "rtde_control" else [])


def test_the_child_starts_asynchronous_moves_only() -> None:
    calls = re.findall(r"\.(move\w+|servo\w+|speed\w+)\(([^)]*)\)", _code_of(_UR_PACKAGE / "child.py"))
    assert [name for name, _ in calls] == ["moveJ"]
    assert calls[0][1].replace(" ", "") == "target_rad,speed_rad_s,acceleration_rad_s2,True"


def test_the_robot_api_is_given_one_order() -> None:
    code = _code_of(_UR_PACKAGE / "robot_api.py")
    assert re.findall(r'"(PUT|POST|DELETE|PATCH)"', code) == ["PUT"]
    assert re.findall(r'\{"action": "(\w+)"\}', code) == ["stop"]


def test_the_source_check_detects_forbidden_names() -> None:
    child = _code_of(_UR_PACKAGE / "child.py")
    assert "FLAG_UPLOAD_SCRIPT" in child
    assert "import RTDEControlInterface" in child
    assert "may wait for ever" not in child  # its docstring is gone
