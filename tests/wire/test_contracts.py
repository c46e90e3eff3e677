"""Runs the contract of each interface against every driver, over the wire."""

import pytest

from tests.wire.contract_gauge import GaugeContract
from tests.wire.contract_mastering import MasteringContract
from tests.wire.contract_probe import ProbeContract
from tests.wire.contract_robot import RobotContract
from tests.wire.robot_cases import ROBOTS


class TestRobots(RobotContract):
    """All robots."""


@pytest.mark.parametrize("robot_case", [ROBOTS["modbus_robot"]], ids=["modbus_robot"])
class TestMasteringStores(MasteringContract):
    """Robots that keep mastering data."""


class TestGauges(GaugeContract):
    """All gauges."""


class TestProbes(ProbeContract):
    """All touch probes."""
