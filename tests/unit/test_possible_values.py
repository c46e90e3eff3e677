"""Finite numbers that no arm can tell are no readings, and a robot that tells no number is not another one."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from cellcal.calibration.geometry import Pose
from cellcal.drivers.abb.robot_web_services.config import AbbWebServicesConfig
from cellcal.drivers.abb.robot_web_services.dialects import SecondDialect
from cellcal.drivers.abb.robot_web_services.robot import AbbOptions, AbbRobot
from cellcal.drivers.abb.robot_web_services.state import read_joints, read_state, read_unit_names
from cellcal.drivers.errors import RefusedError, WireProtocolError, WrongDeviceError
from cellcal.drivers.wire.possible_values import check_joints, check_mass, check_override, check_pose
from cellcal.drivers.wire.serial_number import check_serial_number
from cellcal.drivers.wire.trace import FrameTrace

UNIT = "/rw/motionsystem/mechunits/ROB_1"


@pytest.mark.parametrize("value", [math.nan, math.inf, -2001.0, 2.1e6])
def test_an_angle_where_no_axis_can_stand_is_no_reading(value: float) -> None:
    assert check_joints("arm", (0.0, 2000.0)) == (0.0, 2000.0)
    with pytest.raises(WireProtocolError, match="axis 2"):
        check_joints("arm", (0.0, value))


@pytest.mark.parametrize("value", [1e27, -1001.0])
def test_places_and_loads_out_of_this_hall_are_no_readings(value: float) -> None:
    with pytest.raises(WireProtocolError, match="m away"):
        check_pose("arm", Pose((0.0, value, 0.0), (1.0, 0.0, 0.0, 0.0)))
    with pytest.raises(WireProtocolError, match="kg"):
        check_mass("arm", value * 1e3)


@pytest.mark.parametrize(
    ("share", "fits"), [(0.0, True), (1.0000001, True), (1.5, False), (-0.05, False), (math.nan, False)]
)
def test_an_override_is_a_share(share: float, fits: bool) -> None:
    if fits:
        assert 0.0 <= check_override("arm", share) <= 1.0
        return
    with pytest.raises(RefusedError, match="outside 0 to 100"):
        check_override("arm", share)


def test_a_robot_that_tells_no_serial_number_is_not_another_one() -> None:
    with pytest.raises(RefusedError, match="tells no serial number"):
        check_serial_number("arm", " ", "F-1")
    with pytest.raises(WrongDeviceError):
        check_serial_number("arm", "F-2", "F-1")
    check_serial_number("arm", "F-1", "F-1")


class AnsweringLink:
    """Robot Web Services that answer what is stated, and as a sound controller else."""

    device, dialect, trace = "abb", SecondDialect(), FrameTrace("abb")

    def __init__(self, path: str, **spoilt: Any) -> None:
        self._path, self._spoilt = path, spoilt

    async def get_state(self, path: str, **_query: str) -> dict[str, Any]:
        sound = {f"rax_{axis}": "1.5" for axis in range(1, 7)}
        sound |= {
            "opmode": "AUTO",
            "ctrlstate": "motoron",
            "axis-status": "Synchronized",
            "status": "Synchronized",
        }
        sound |= {"tool-name": "tool0", "wobj-name": "wobj0", "ctrl-type": "IRB", "ctrl-id": "S1"}
        return sound | (self._spoilt if path == self._path else {})


@pytest.mark.parametrize(
    ("path", "spoilt", "read", "words"),
    [
        (f"{UNIT}/jointtarget", {"rax_3": "123456789"}, read_joints, "axis 3"),
        (UNIT, {"status": 5}, read_state, "status is missing"),
        (UNIT, {"status": ["Synchronized"]}, read_state, "status is missing"),
        (UNIT, {"tool-name": "t/../../ctrl"}, read_unit_names, "tool-name is no name"),
    ],
)
async def test_a_foreign_answer_is_unreadable_and_no_state_of_the_robot(
    path: str, spoilt: dict[str, Any], read: Callable[[Any], Any], words: str
) -> None:
    await read(AnsweringLink("nothing"))
    with pytest.raises(WireProtocolError, match=words):
        await read(AnsweringLink(path, **spoilt))


@pytest.mark.parametrize("number", [["S1"], 5, "S\x1b[2J"])
async def test_a_name_plate_of_another_type_is_no_other_robot(number: Any) -> None:
    entry = {"driver": "abb_web_services", "name": "abb", "address": "127.0.0.1", "serial": "S1"}
    entry |= {"model": "abb_irb1600_6_12"}
    config = AbbWebServicesConfig.model_validate(entry | {"speed_limit_rad_s": 0.35, "step_s": 0.5})
    link: Any = AnsweringLink("/ctrl/identity", **{"ctrl-id": number})
    with pytest.raises(WireProtocolError, match="ctrl-id"):
        await AbbRobot(link, AbbOptions("S1", config.stepwise_options(6))).identify()
