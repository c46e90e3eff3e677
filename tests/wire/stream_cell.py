"""A cell file with an ABB and a KUKA whose joints come by a stream, too."""

from tests.cell_tables import cell_head
from tests.wire.fake_devices_process import ABB_ROBOT, EGM_STREAM, FAKE_TABLE, KUKA_ROBOT

STREAM_CELL = cell_head("joint streams") + ABB_ROBOT + EGM_STREAM + KUKA_ROBOT + FAKE_TABLE
