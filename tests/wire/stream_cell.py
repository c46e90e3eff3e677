"""A cell file with an ABB and a KUKA whose joints come by a stream, too."""

from tests.wire.fake_devices_process import ABB_ROBOT, EGM_STREAM, FAKE_TABLE, KUKA_ROBOT

_HEAD = """\
[cell]
name = "joint streams"
data_dir = "{folder}"

"""
STREAM_CELL = _HEAD + ABB_ROBOT + EGM_STREAM + KUKA_ROBOT + FAKE_TABLE
