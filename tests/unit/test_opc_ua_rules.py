"""Rules of the OPC UA driver without a wire: units, order of axes, standstill, stops, entries of the cell file."""

import math
import struct
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asyncua import ua
from asyncua.common.utils import Buffer

from cellcal.drivers.errors import RefusedError
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.opc_ua import server_link
from cellcal.drivers.opc_ua.axis_units import order_axes, unit_of_axis
from cellcal.drivers.opc_ua.config import OpcUaConfig
from cellcal.drivers.opc_ua.safety_state import SafetyState, condition_of, mode_name
from cellcal.drivers.opc_ua.standstill import StandstillWatch
from cellcal.drivers.opc_ua.value_times import ValueTimes, describe_age

CEFACT = "http://www.opcfoundation.org/UA/units/un/cefact"


def stated_unit(number: int, shown: str, uri: str = CEFACT) -> ua.EUInformation:
    return ua.EUInformation(uri, number, ua.LocalizedText(shown), ua.LocalizedText(""))


@pytest.mark.parametrize(
    ("number", "shown", "profile", "to_si"),
    [
        (17476, "°", 1, math.radians(1.0)),
        (17476, "", 2, math.radians(1.0)),
        (4405297, "rad", 1, 1.0),
        (5066068, "mm", 3, 1e-3),
        (-1, "deg", 1, math.radians(1.0)),
        (0, "Radian", 1, 1.0),
    ],
)
def test_known_units(number: int, shown: str, profile: int, to_si: float) -> None:
    assert unit_of_axis("r", "A1", stated_unit(number, shown), profile).to_si == pytest.approx(to_si)


@pytest.mark.parametrize(
    ("stated", "profile"),
    [
        (stated_unit(17476, "rad"), 1),  # contradicts itself
        (stated_unit(4405297, "deg"), 1),
        (stated_unit(-1, ""), 1),
        (stated_unit(17476, "deg", "urn:other-units"), 1),
        (stated_unit(17476, "deg"), 3),
        (stated_unit(5066068, "mm"), 1),
        (stated_unit(17476, "deg"), 0),
        (stated_unit(17476, "deg"), 4),
        (None, 1),
        ("deg", 1),
    ],
)
def test_units_that_are_unknown_or_do_not_fit_are_refused(stated: object, profile: int) -> None:
    with pytest.raises(RefusedError) as refusal:
        unit_of_axis("r", "A1", stated, profile)
    assert "A1" in str(refusal.value)


def test_numbered_axes_are_ordered_by_their_numbers() -> None:
    found = ["Axis 2", "Axis 10", "Axis 9", "Axis 3"]
    with pytest.raises(RefusedError):
        order_axes("r", found, (), 4)
    assert order_axes("r", ["J3", "J1", "J2"], (), 3) == ["J1", "J2", "J3"]
    assert order_axes("r", [f"A{k}" for k in (7, 9, 8, 10)], (), 4) == ["A7", "A8", "A9", "A10"]
    for wrong in (
        ["A1", "A2", "E3"],
        ["A1", "A2"],
        ["A1", "A2", "A3", "A4"],
        ["A1", "A1", "A2"],
        ["A", "B", "C"],
        [],
    ):
        with pytest.raises(RefusedError):
            order_axes("r", wrong, (), 3)
    assert order_axes("r", ["T", "E1", "S"], ("S", "T"), 2) == ["S", "T"]


def test_an_arm_stands_when_no_reading_of_the_last_moment_differs() -> None:
    watch = StandstillWatch(1.0)
    assert watch.is_moving() is None
    watch.add_reading(0.0, (0.0, 0.0))
    watch.add_reading(0.5, (0.0, 0.0))
    assert watch.is_moving() is None
    watch.add_reading(1.0, (0.0, 0.0001))
    assert watch.is_moving() is False
    watch.add_reading(1.1, (0.0, 0.01))
    assert watch.is_moving() is True
    watch.add_reading(1.9, (0.0, 0.01))
    assert watch.is_moving() is True
    watch.add_reading(2.2, (0.0, 0.01))
    assert watch.is_moving() is False
    watch.add_reading(30.0, (0.0, 0.01))  # what is older does not count
    assert watch.is_moving() is None
    watch.forget()
    assert watch.is_moving() is None


def test_one_stop_of_several_safety_states_stops_the_robot() -> None:
    healthy, stopped = SafetyState(3, False, False), SafetyState(1, True, False)
    assert condition_of([healthy, stopped]).readiness is Readiness.STOPPED
    assert condition_of([]).readiness is Readiness.NOT_READY
    assert mode_name("r", [healthy, stopped, healthy]) == "AUTOMATIC, MANUAL_REDUCED_SPEED"


@pytest.mark.parametrize(
    "changes",
    [
        {"still_s": 2.0, "deadline_s": 2.0},
        {"axes": ["A1", "A1"]},
        {"path": "no slash"},
        {"port": 0},
        {"certificate": "ours.der"},
        {"user": "reader"},
        {"password": "s3cret"},
    ],
)
def test_entries_that_cannot_work_are_refused(changes: dict[str, Any]) -> None:
    entry = {"driver": "opc_ua", "name": "r", "address": "10.0.0.1", "model": "ur10e", "serial": "1"}
    with pytest.raises(ValueError, match=next(iter(changes))):
        OpcUaConfig.model_validate({**entry, **changes})


def test_an_array_of_nothing_with_a_damaged_length_is_refused_at_once() -> None:
    octets = bytes([0x80]) + struct.pack(
        "<i", 2**31 - 1
    )  # as many elements as fit, none of which takes an octet
    with pytest.raises(ValueError, match="empty values"):
        server_link.ua_binary.variant_from_binary(Buffer(octets))


NOON = datetime(2026, 11, 30, 12, tzinfo=UTC)


def at_s(seconds: float) -> datetime:
    return NOON + timedelta(seconds=seconds)


def test_a_time_that_stands_still_counts_where_each_sample_had_its_own() -> None:
    times = ValueTimes()
    for k in range(3):
        times.take_value("r", "A1", 12.0, at_s(k), float(k))
    times.take_value("r", "A1", 12.0, at_s(2.0), 6.9)
    with pytest.raises(RefusedError, match="time has stood still for 6 s"):
        times.take_value("r", "A1", 12.0, at_s(2.0), 8.0)
    times.take_value("r", "A1", 12.5, at_s(8.5), 8.5)


def test_a_server_that_stamps_changes_alone_is_read_while_the_arm_stands() -> None:
    times = ValueTimes()
    for k in range(1000):
        times.take_value("r", "A1", 12.0, NOON, float(k))
    times.take_value("r", "A1", 13.0, at_s(1000), 1000.0)
    times.take_value("r", "A1", 13.0, at_s(1000), 2000.0)
    times.take_value("r", "A1", 13.0, None, 2001.0)


def test_an_older_value_is_refused_once_and_the_next_ones_count_from_it() -> None:
    times = ValueTimes()
    times.take_value("r", "A1", 12.0, at_s(9), 0.0)
    with pytest.raises(RefusedError, match="A1 that is older"):
        times.take_value("r", "A1", 11.0, at_s(8).replace(tzinfo=None), 0.1)
    times.take_value("r", "A1", 11.0, at_s(8), 0.2)


def test_times_of_positions_are_doubted_where_they_prove_nothing() -> None:
    assert describe_age([at_s(0), at_s(4)], at_s(4.5)) == ""
    assert "34 s before" in describe_age([at_s(0), at_s(4)], at_s(34))
    assert "no time" in describe_age([at_s(0), None], at_s(0))
    assert describe_age([at_s(0)], None) == ""
