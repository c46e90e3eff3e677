"""A number of a controller is one number, or a refusal: nothing that only Python takes for one."""

import math
from collections.abc import Callable

import pytest

from cellcal.calibration.documents.plain_numbers import parse_number, parse_whole
from cellcal.drivers.abb.robot_web_services.generation import ServiceAddress
from cellcal.drivers.abb.robot_web_services.rapid_values import read_numbers, read_tool
from cellcal.drivers.abb.robot_web_services.state import number_of
from cellcal.drivers.abb.robot_web_services.web_link import WebLink
from cellcal.drivers.errors import WireProtocolError
from cellcal.drivers.fanuc.rmi.rmi_link import RmiLink
from cellcal.drivers.fanuc.rmi.rmi_state import read_position
from cellcal.drivers.file_import.number_text import parse_number as parse_typed_number
from cellcal.drivers.kuka.sensor_interface.packets import read_robot_packet
from cellcal.drivers.kuka.variables.values import read_axes, read_members
from cellcal.drivers.yaskawa.tool_file import read_tools

NO_NUMBERS = (
    *(
        "nan",
        "inf",
        "-Infinity",
        "1_0",
        "\uff11\uff12",
        "\u0661\u0662",
        "\u00b2",
        "0x10",
        "1e999",
        "--1",
        "1-2",
        "1 2",
        "1e",
        "true",
    ),
    *("", ".", "9" * 65, "1\x00", "\N{MINUS SIGN}1", "1j"),
)
LINK = WebLink(ServiceAddress("arm", "127.0.0.1", 1), ("u", "p"), deadline_s=1.0)
REFUSED = (ValueError, WireProtocolError)


def read_tool_file(text: str) -> object:
    found = read_tools(f"//TOOL 0\n{text},0,0,0,0,0\n0,0,0\n1.0\n")
    if not found:
        raise ValueError(text)
    return found


def read_datagram(text: str) -> object:
    joints = " ".join(f'A{axis}="{text if axis == 3 else 0.5}"' for axis in range(1, 7))
    return read_robot_packet(f"<Rob><AIPos {joints}/><IPOC>1</IPOC></Rob>".encode())


READERS: dict[str, Callable[[str], object]] = {
    "any": parse_number,
    "any whole": parse_whole,
    "ABB, a state": lambda text: number_of(LINK, {"x": text}, "x"),
    "ABB, RAPID": lambda text: read_numbers(f"[1.0,{text},2]"),
    "ABB, tooldata": lambda text: read_tool(f"[TRUE,[[0,0,{text}],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]]"),
    "KUKA, axes": lambda text: read_axes(f"{{E6AXIS: A1 1.0, A2 {text}, A3 1, A4 1, A5 1, A6 1}}"),
    "KUKA, alone": lambda text: read_members(f"{{X {text}}}"),
    "KUKA, datagram": read_datagram,
    "Yaskawa, TOOL.CND": read_tool_file,
    "Instruments": parse_typed_number,
}


@pytest.mark.parametrize("text", NO_NUMBERS)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_number_is_refused(reader: str, text: str) -> None:
    if reader == "Instruments" and text.startswith("\N{MINUS SIGN}"):
        return  # people copy it from text
    with pytest.raises(REFUSED):
        READERS[reader](text)


@pytest.mark.parametrize("text", ["0", "-0.0001", "1.5E-05", "+3.25e2", "120."])
@pytest.mark.parametrize("reader", [name for name in READERS if name != "any whole"])
def test_what_a_controller_writes_is_read(reader: str, text: str) -> None:
    if reader != "KUKA, datagram" or not text.endswith("."):
        READERS[reader](text)


@pytest.mark.parametrize("value", [True, False, None, [1], {}, math.nan, math.inf])
def test_a_value_of_json_that_is_no_number_is_refused(value: object) -> None:
    with pytest.raises(WireProtocolError):
        number_of(LINK, {"x": value}, "x")


@pytest.mark.parametrize("value", [True, None, "3", 3.7, math.nan])
async def test_a_number_of_a_frame_is_whole(value: object, monkeypatch: pytest.MonkeyPatch) -> None:
    link = RmiLink("arm", "127.0.0.1", 1, deadline_s=1.0)

    async def answer(_command: str) -> dict[str, object]:
        position = dict.fromkeys("XYZWPR", 0.0)
        return {"Position": position, "Configuration": {"UFrameNumber": 1, "UToolNumber": value}}

    monkeypatch.setattr(link, "send_command", answer)
    with pytest.raises(WireProtocolError):
        await read_position(link)


def test_a_whole_number_is_never_cut_short() -> None:
    assert parse_whole("3.0") == 3
    for text in ("3.7", "-0.5", "1e17", "[3]"):
        with pytest.raises(ValueError, match="number"):
            parse_whole(text)


@pytest.mark.parametrize("code", [False, True, 0.0, "0", None, [0]])
def test_an_error_number_of_rmi_is_a_whole_number(code: object) -> None:
    link = RmiLink("arm", "127.0.0.1", 1, deadline_s=1.0)
    with pytest.raises(WireProtocolError, match="ErrorID"):
        link.accept_reply({"Command": "FRC_Reset", "ErrorID": code})
    assert link.accept_reply({"Command": "FRC_Reset", "ErrorID": 0})
