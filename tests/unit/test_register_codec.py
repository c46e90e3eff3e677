"""Words of the controller's document, typed from it, against the codec and the profile."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellcal.drivers.draw_wire.objects import decode_entry as decode_object
from cellcal.drivers.draw_wire.objects import load_objects
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.modbus_robot.profile import ControllerProfile, load_profile, profile_names
from cellcal.drivers.modbus_robot.register_client import RegisterClient
from cellcal.drivers.modbus_robot.registers import (
    RegisterAccess,
    RobotRegister,
    decode_text,
    decode_words,
    encode_values,
)
from cellcal.drivers.wire.modbus import ModbusLink
from cellcal.drivers.wire.tables import code_table

FANUC = load_profile("fanuc_hmi")

# name: (address, words, writable) as the two tables of deploy/controller_setup/fanuc_hmi.md have them
DOCUMENT = {
    "xyz": (1, 6, False),
    "wpr": (7, 6, False),
    "pose_valid": (26, 1, False),
    "joints": (27, 12, False),
    "joints_valid": (45, 1, False),
    "user_number": (46, 1, False),
    "tool_number": (47, 1, False),
    "counts_at_zero": (51, 12, True),
    "counts": (63, 12, False),
    "mastered": (99, 2, True),
    "acknowledge": (103, 2, True),
    "override": (105, 2, True),
    "counts_per_radian": (107, 12, False),
    "inverse_ratio": (119, 12, False),
    "interaction": (131, 72, False),
    "epoch": (203, 2, False),
    "serial": (301, 40, False),
    "model": (341, 40, False),
    "firmware": (381, 40, False),
    "request": (3001, 2, True),
    "operation": (3003, 2, True),
    "number": (3005, 2, True),
    "target": (3007, 12, True),
    "speed": (3019, 2, True),
    "hold": (3021, 2, True),
    "heartbeat": (3023, 2, True),
    "answered": (3041, 2, False),
    "state": (3043, 2, False),
    "reason": (3045, 2, False),
    "moving": (3047, 2, False),
    "mode": (3049, 2, False),
    "emergency": (3051, 2, False),
    "counter": (3053, 2, False),
}


def make_register(kind: str, words: int, unit: str = "", multiply: float = 1.0) -> RobotRegister:
    return RobotRegister.model_validate({
        "address": 1, "words": words, "type": kind, "unit": unit, "multiply": multiply,
        "access": "read_write", "source": "here",
    })  # fmt: skip


@pytest.mark.parametrize("name", sorted(DOCUMENT))
def test_the_profile_has_every_register_where_the_document_has_it(name: str) -> None:
    address, words, writable = DOCUMENT[name]
    found = FANUC.registers[name]
    assert (found.address, found.words, found.access is not RegisterAccess.READ) == (address, words, writable)
    assert found.source


@pytest.mark.parametrize(
    ("kind", "number", "address"),
    [("tool", 1, 501), ("tool", 10, 951), ("user", 1, 1001), ("user", 9, 1401)],
)
def test_frames_lie_fifty_words_apart(kind: str, number: int, address: int) -> None:
    assert FANUC.registers[f"{kind}_xyz"].register_of_item(number).address == address
    assert FANUC.registers[f"{kind}_wpr"].register_of_item(number).address == address + 6
    assert FANUC.registers[f"{kind}_valid"].register_of_item(number).address == address + 25


def test_alarms_lie_a_hundred_words_apart() -> None:
    fifth = {
        name: FANUC.registers[name].register_of_item(5).address
        for name in ("alarm_id", "alarm_number", "alarm_text")
    }
    assert fifth == {"alarm_id": 2401, "alarm_number": 2402, "alarm_text": 2412}
    with pytest.raises(ValueError, match="1 to 5"):
        FANUC.registers["alarm_id"].register_of_item(6)


@pytest.mark.parametrize(
    ("kind", "unit", "words", "values"),
    [
        ("float32", "", (0x0000, 0x3F80), (1.0,)),
        ("float32", "mm", (0x0000, 0x447A), (1.0,)),  # 1000 mm
        ("float32", "deg", (0x0000, 0x4334), (math.pi,)),  # 180 deg
        ("float32", "deg", (0x0000, 0xC2B4), (-math.pi / 2,)),  # -90 deg
        (
            "float32",
            "counts/deg",
            (0x6666, 0x482C),
            (struct.unpack("<f", b"\x66\x66\x2c\x48")[0] * 180 / math.pi,),
        ),
        ("int32", "", (0x0001, 0x0000), (1.0,)),
        ("int32", "counts", (0x0000, 0x0008), (524288.0,)),  # 2^19: low word first
        ("int32", "counts", (0xFFFF, 0xFFFF), (-1.0,)),
        ("int32", "counts", (0x0000, 0x8000), (-2147483648.0,)),
        ("int32", "%", (0x0064, 0x0000), (1.0,)),
        ("int16", "", (0xFFFE,), (-2.0,)),
        ("int32", "", (0x0002, 0x0000, 0xFFFD, 0xFFFF), (2.0, -3.0)),
    ],
)
def test_golden_words(kind: str, unit: str, words: tuple[int, ...], values: tuple[float, ...]) -> None:
    found = make_register(kind, len(words), unit)
    assert decode_words(found, words) == pytest.approx(values, rel=1e-12)
    assert encode_values(found, values) == words


def test_a_multiplied_integer_is_divided() -> None:
    found = make_register("int32", 2, "mm", multiply=1000)
    assert decode_words(found, (1500, 0)) == pytest.approx((1.5e-3,))
    assert encode_values(found, (1.5e-3,)) == (1500, 0)


def test_text_has_its_low_byte_first_and_ends_at_nul() -> None:
    words = (0x2D46, 0x3031, 0x3734, 0x3131, 0x0000, 0x4141)  # "F-", "10", "47", "11", end, rubbish
    assert decode_text(make_register("text", 6), words) == "F-104711"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("float32", (0x0000, 0x7FC0)),  # NaN
        ("float32", (0x0000, 0x7F80)),  # infinity
        ("float32", (0x0000,)),  # half a value
        ("int32", (0x0000, 0x0000, 0x0000)),  # too long
        ("int32", (0x10000, 0x0000)),  # no word
        ("int32", (-1, 0x0000)),
    ],
)
def test_words_that_are_no_value_are_refused(kind: str, words: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"."):
        decode_words(make_register(kind, 2), words)


@pytest.mark.parametrize("value", [math.nan, math.inf, 2.0**31, -(2.0**31) - 1])
def test_values_that_do_not_fit_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"."):
        encode_values(make_register("int32", 2), (value,))


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=6, max_size=6))
def test_counts_survive_the_wire_exactly(counts: list[int]) -> None:
    found = FANUC.registers["counts_at_zero"]
    assert [int(value) for value in decode_words(found, encode_values(found, counts))] == counts


@given(st.lists(st.floats(-360, 360, width=32), min_size=6, max_size=6))
def test_angles_survive_the_wire_to_a_tenth_of_an_arc_second(degrees: list[float]) -> None:
    found = FANUC.registers["joints"]
    radians = [math.radians(value) for value in degrees]
    assert decode_words(found, encode_values(found, radians)) == pytest.approx(radians, abs=5e-7)


def test_every_profile_that_ships_can_be_loaded() -> None:
    assert "fanuc_hmi" in profile_names()
    for name in profile_names():
        assert load_profile(name).name == name


def test_a_block_that_does_not_fit_into_one_telegram_is_refused() -> None:
    document = FANUC.model_dump()
    document["blocks"]["too_long"] = ("xyz", "interaction")
    with pytest.raises(ValueError, match="more than 125"):
        ControllerProfile.model_validate(document)
    document["blocks"] = {"odd": ("nothing",)}
    with pytest.raises(ValueError, match="unknown registers: nothing"):
        ControllerProfile.model_validate(document)


async def test_what_cannot_be_written_never_reaches_the_link() -> None:
    panel = RegisterClient(ModbusLink("robot", "127.0.0.1", 1, deadline_s=0.1), FANUC)
    with pytest.raises(ValueError, match="cannot be written"):
        await panel.write_registers({"counts": (0,) * 6})  # read only
    with pytest.raises(ValueError, match="cannot be written"):
        await panel.write_registers({"request": (1,), "number": (1,)})  # a gap between them
    with pytest.raises(RefusedError):
        await panel.write_registers({"counts_at_zero": (2**31,) * 6})


@pytest.mark.parametrize(
    ("package", "table", "codes"),
    [
        ("cellcal.drivers.modbus_robot", "reasons.tsv", range(1, 13)),
        (
            "cellcal.drivers.modbus_robot",
            "alarms.tsv",
            (11001, 11038, 11050, 11062, 11064, 11065, *range(11068, 11076)),
        ),
        ("cellcal.drivers.wire", "modbus_exceptions.tsv", (1, 2, 3, 4, 5, 6, 8, 10, 11)),
        ("cellcal.drivers.draw_wire", "emergencies.tsv", (0x1000, 0x5000, 0x8130, 0xFF00)),
    ],
)
def test_every_code_of_the_documents_has_a_text_and_a_remedy(
    package: str, table: str, codes: tuple[int, ...]
) -> None:
    found = code_table(package, table)
    for code in codes:
        assert found[code].text
        assert found[code].remedy.endswith(".")
    assert all(code == entry.code for code, entry in found.items())


@pytest.mark.parametrize(
    ("name", "place", "data", "value"),
    [
        ("position", (0x6004, 0), b"\xff\xff\xff\xff", -1),  # linear encoders count with a sign
        ("position", (0x6004, 0), b"\x10\x27\x00\x00", 10000),
        ("step", (0x6005, 1), b"\xa0\x86\x01\x00", 100000),  # 0.1 mm
        ("device_type", (0x1000, 0), b"\x96\x01\x08\x00", 0x00080196),
        ("error_register", (0x1001, 0), b"\x81", 0x81),
        ("serial", (0x1018, 4), b"\x67\x12\x00\x00", 4711),
    ],
)
def test_golden_objects(name: str, place: tuple[int, int], data: bytes, value: int) -> None:
    entry = load_objects().objects[name]
    assert (entry.index, entry.sub) == place
    assert decode_object(entry, data) == value
    with pytest.raises(ValueError, match="bytes instead of"):
        decode_object(entry, data + b"\x00")


def test_a_step_of_a_hundred_thousand_is_a_tenth_of_a_millimetre() -> None:
    assert 100000 * load_objects().objects["step"].scale == pytest.approx(1e-4)
