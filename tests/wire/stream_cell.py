"""A cell file with an ABB and a KUKA whose joints come by a stream, too."""

from tests.cell_tables import cell_head
from tests.wire.fake_devices_process import FAKE_TABLE
from tests.wire.robot_cases import ABB_TABLE, EGM_TABLE, KUKA_TABLE

STREAM_CELL = cell_head("joint streams") + ABB_TABLE + EGM_TABLE + KUKA_TABLE + FAKE_TABLE
