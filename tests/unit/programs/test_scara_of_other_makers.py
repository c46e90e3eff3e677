"""A SCARA that runs RAPID or KRL: poses go with the work by plane trigonometry, unknown configurations are left."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellcal.service.cli.app import run_command_line
from tests.unit.programs.test_other_arms import (
    OFFSET,
    PROJECT,
    SCARA,
    in_frame,
    moved_by_hand,
    scara_tip_mm,
)

POSTURES = [(10.0, 40.0, 30.0, 15.0), (-35.0, 60.0, 80.0, -120.0), (20.0, 95.0, 25.0, 170.0)]
TOOL = "PERS tooldata tl:=[TRUE,[[40,0,120],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];"
WORK = 'PERS wobjdata wo:=[FALSE,TRUE,"",[[100,-50,20],[0.9659258262890683,0,0,0.25881904510252074]],[[0,0,0],[1,0,0,0]]];'
KRL_FRAMES = "$TOOL={X 40,Y 0,Z 120,A 0,B 0,C 0}\n$BASE={X 100,Y -50,Z 20,A 30,B 0,C 0}\n"
NUMBER = r"(-?[\d.]+)"


def rapid(configurations: list[str]) -> str:
    moves = []
    for joints, configuration in zip(POSTURES, configurations, strict=True):
        place, yaw = in_frame(*scara_tip_mm(*joints))
        x, y, z, w = Rotation.from_euler("ZYX", [yaw, 0, np.pi]).as_quat()
        numbers = ",".join(f"{value:.4f}" for value in place)
        turn = ",".join(f"{value:.9f}" for value in (w, x, y, z))
        moves.append(
            f"MoveJ [[{numbers}],[{turn}],{configuration},[9E9,9E9,9E9,9E9,9E9,9E9]],v100,fine,tl\\WObj:=wo;"
        )
    return "\n".join(["MODULE m", TOOL, WORK, "PROC main()", *moves, "ENDPROC", "ENDMODULE", ""])


def krl(configurations: list[str]) -> str:
    moves = []
    for joints, configuration in zip(POSTURES, configurations, strict=True):
        (x, y, z), yaw = in_frame(*scara_tip_mm(*joints))
        moves.append(
            f"PTP {{X {x:.4f},Y {y:.4f},Z {z:.4f},A {np.degrees(yaw):.5f},B 0.0,C 180.0{configuration}}}\n"
        )
    return f"DEF m ( )\n{KRL_FRAMES}{''.join(moves)}END\n"


def places_of(text: str) -> list[tuple[list[float], float]]:
    """Return the place [mm] and the yaw [rad] of each point."""
    found = []
    for one in re.finditer(
        rf"Move. \[\[{NUMBER},{NUMBER},{NUMBER}\],\[{NUMBER},{NUMBER},{NUMBER},{NUMBER}\]", text
    ):
        *place, w, x, y, z = map(float, one.groups())
        found.append((place, Rotation.from_quat([x, y, z, w]).as_euler("ZYX")[0]))
    for one in re.finditer(rf"PTP \{{X {NUMBER},Y {NUMBER},Z {NUMBER},A {NUMBER}", text):
        *place, yaw = map(float, one.groups())
        found.append((place, float(np.radians(yaw))))
    return found


def move(tmp_path: Path, name: str, text: str, *offset: str) -> tuple[int, str]:
    (tmp_path / name).write_text(text)
    project = PROJECT.format(model=SCARA, robot="starting_posture_deg = [10, 40, 30, 15]")
    project = project.replace("[tools.1.", "[tools.tl.").replace("[frames.2]", "[frames.wo]")
    (tmp_path / "project.toml").write_text(project)
    words = ["program", "move", str(tmp_path / name), "--project", str(tmp_path / "project.toml")]
    code = run_command_line([*words, "--offset", *offset, "--out", str(tmp_path / "out")])
    return code, (tmp_path / "out" / name).read_text()


def test_poses_in_rapid_go_with_the_work(tmp_path: Path) -> None:
    code, text = move(tmp_path, "m.mod", rapid(["[0,0,0,0]"] * 3), OFFSET, "--frame", "wo")
    assert code == 0
    assert_moved_by_hand(places_of(text))


def test_poses_in_krl_go_with_the_work_from_base(tmp_path: Path) -> None:
    """The program sets its base to numbers, so that the change is seen in the robot's base."""
    code, text = move(tmp_path, "m.src", krl([""] * 3), "20,-10,5,0,0,4")
    assert code == 0
    turn, angle = np.radians(4.0), np.radians(30.0)
    for (place, yaw), joints in zip(places_of(text), POSTURES, strict=True):
        old, old_yaw = scara_tip_mm(*joints)
        c, s = np.cos(turn), np.sin(turn)
        expected = np.array([c * old[0] - s * old[1] + 20, s * old[0] + c * old[1] - 10, old[2] + 5])
        c, s = np.cos(angle), np.sin(angle)
        found = np.array([c * place[0] - s * place[1] + 100, s * place[0] + c * place[1] - 50, place[2] + 20])
        assert np.abs(found - expected).max() < 1e-3
        assert abs(np.remainder(yaw + angle - old_yaw - turn + np.pi, 2 * np.pi) - np.pi) < 2e-6


def assert_moved_by_hand(found: list[tuple[list[float], float]]) -> None:
    assert len(found) == len(POSTURES)
    for (place, yaw), joints in zip(found, POSTURES, strict=True):
        expected, expected_yaw = in_frame(*moved_by_hand(*scara_tip_mm(*joints)))
        assert np.abs(np.array(place) - expected).max() < 1e-3
        assert abs(np.remainder(yaw - expected_yaw + np.pi, 2 * np.pi) - np.pi) < 2e-6


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("m.mod", rapid(["[0,0,0,0]", "[-1,-2,0,0]", "[0,1,0,0]"])),
        ("m.src", krl([",S 2,T 0", ",S 2,T 9", ",S 6,T 0"])),
    ],
)
def test_a_configuration_that_no_document_explains_is_left(
    tmp_path: Path, capsys, name: str, text: str
) -> None:
    code, written = move(tmp_path, name, text, "20,-10,5,0,0,4")
    assert code == 4
    assert "4 joints" in " ".join(capsys.readouterr().out.split())
    changed = [one for one, old in zip(places_of(written), places_of(text), strict=True) if one != old]
    assert len(changed) < len(POSTURES)
