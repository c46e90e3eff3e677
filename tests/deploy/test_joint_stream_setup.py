"""The files for a controller that sends its joints: they fit the cell files, and nothing in them can move an arm."""

import re
from pathlib import Path

import pytest
from defusedxml.ElementTree import parse

from cellcal.service.configuration.cell_file import read_cell_file

ROOT = Path(__file__).parents[2]
SETUP = ROOT / "deploy" / "controller_setup"


def without_remarks(file: Path, sign: str) -> str:
    return re.sub(f"{re.escape(sign)}.*", "", file.read_text(encoding="utf-8"))


def test_the_rapid_module_starts_a_position_stream_and_no_guidance() -> None:
    text = without_remarks(SETUP / "abb" / "CellcalStream.mod", "!")
    used = set(re.findall(r"\bEGM\w+", text))
    assert used == {"EGMReset", "EGMGetId", "EGMSetupUC", "EGMStreamStart"}
    assert not re.search(r"\b(Move|Mocap|Corr)\w*", text)
    assert text.count("PROC ") == text.count("ENDPROC") == 2
    assert text.count("WHILE ") == text.count("ENDWHILE")


def test_the_krl_program_corrects_nothing() -> None:
    text = without_remarks(SETUP / "kuka" / "CELLCAL_RSI.SRC", ";")
    assert set(re.findall(r"\bRSI_\w+(?=\()", text)) == {"RSI_CREATE", "RSI_ON"}
    assert re.findall(r"\b(?:PTP|LIN|CIRC)\b.*", text) == ["PTP $AXIS_ACT"]  # to where the arm stands
    assert text.count("IF (") == text.count("ENDIF")
    assert (text.count("LOOP"), text.count("DEF ")) == (2, 1)


def test_the_configuration_of_rsi_wants_no_answer_and_sends_the_joints() -> None:
    root = parse(SETUP / "kuka" / "CELLCAL_RSI.XML").getroot()
    assert root.findtext("CONFIG/ONLYSEND") == "TRUE"
    assert not root.findall("RECEIVE/ELEMENTS/*")
    assert "DEF_AIPos" in [element.get("TAG") for element in root.findall("SEND/ELEMENTS/ELEMENT")]
    uncommented = example("kuka_variables", "rsi")
    assert f"port = {root.findtext('CONFIG/PORT')}" in uncommented
    assert f'listen = "{root.findtext("CONFIG/IP_NUMBER")}"' in uncommented


def example(name: str, key: str) -> str:
    """Return an example cell file with the stream's remark signs taken away."""
    text = (ROOT / "deploy" / "example_cells" / f"{name}.toml").read_text(encoding="utf-8")
    before, table, after = text.partition(f"# [robot.{key}]")
    assert table
    lines, end, rest = after.partition("\n\n")
    return f"{before}[robot.{key}]{re.sub('^# ', '', lines, flags=re.MULTILINE)}{end}{rest}"


@pytest.mark.parametrize(
    ("name", "key", "sender"),
    [("abb_web_services", "egm", "192.168.125.1"), ("kuka_variables", "rsi", "192.168.1.147")],
)
def test_the_example_cells_are_read_with_their_streams(
    name: str, key: str, sender: str, tmp_path: Path
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(example(name, key), encoding="utf-8")
    (robot,) = read_cell_file(path).robots
    settings = getattr(robot, key)
    assert settings.sender_of(robot.address) == sender
    assert settings.port in (6510, 49152)
