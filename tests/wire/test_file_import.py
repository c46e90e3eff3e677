"""An instrument without a wire: each reading is asked for, fresh, in a named unit, or it is refused."""

import asyncio
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cellcal.drivers.errors import BusyError, DeviceTimeoutError, RefusedError, UnreachableError
from cellcal.drivers.file_import.config import FileGaugeConfig, FileTrackerConfig
from cellcal.drivers.interfaces import Readiness
from cellcal.drivers.operator.scripted import ScriptedOperator

COMMON = {
    "driver": "file_import",
    "name": "hand",
    "serial": "V-17",
    "unit": "mm",
    "sigma_m": 5e-5,
    "range_m": 20.0,
}


def gauge_config(**settings: Any) -> FileGaugeConfig:
    return FileGaugeConfig.model_validate({**COMMON, "source": "typed", **settings})


def tracker_config(path: Path, **settings: Any) -> FileTrackerConfig:
    table = {**COMMON, "source": "growing_file", "path": path, "columns": ["x", "y", "z"], "wait_s": 3.0}
    return FileTrackerConfig.model_validate({**table, **settings})


async def request_point(tracker: Any) -> "asyncio.Task[Any]":
    """Ask for a point and let the device look at what is in the file already."""
    reading = asyncio.create_task(tracker.measure_point())
    file = tracker._rows._file
    content, looked = file.read_content, asyncio.Event()

    async def file_content() -> bytes:
        found = await content()
        looked.set()
        return bytes(found)

    file.read_content = file_content
    await looked.wait()
    file.read_content = content
    return reading


def append_text(path: Path, text: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(text)


class TestTyped:
    async def test_lengths_have_a_unit_and_a_comma(self) -> None:
        async with gauge_config().open(ScriptedOperator({"reading:hand": "1234,567"})) as device:
            reading = await device.read_distance()
            assert reading.value_m == pytest.approx(1.234567, abs=1e-12)
            assert reading.sigma_m == device.capabilities.sigma_m
            assert device.capabilities.typed
            assert reading.raw * device.capabilities.resolution_m == pytest.approx(reading.value_m, abs=1e-15)
            assert (await device.read_condition()).readiness is Readiness.READY

    @pytest.mark.parametrize(("unit", "metres"), [("m", 2.0), ("mm", 2e-3), ("um", 2e-6), ("in", 0.0508)])
    async def test_units_are_those_of_the_cell_file(self, unit: str, metres: float) -> None:
        async with gauge_config(unit=unit).open(ScriptedOperator({"reading:hand": "2"})) as device:
            assert (await device.read_distance()).value_m == pytest.approx(metres)

    @pytest.mark.parametrize("typed_text", ["nan", "1.234,5", "twelve", "-3", "20001"])
    async def test_what_cannot_be_a_length_is_refused(self, typed_text: str) -> None:
        async with gauge_config().open(ScriptedOperator({"reading:hand": typed_text})) as device:
            with pytest.raises(RefusedError) as failure:
                await device.read_distance()
            assert failure.value.remedy

    async def test_a_missing_operator_is_reported(self) -> None:
        async with gauge_config().open() as device:
            with pytest.raises(RefusedError, match="no operator to enter"):
                await device.read_distance()

    async def test_poses_are_typed_in_a_named_convention(self, tmp_path: Path) -> None:
        config = tracker_config(tmp_path, source="typed", orientation="kuka_abc")
        async with config.open(ScriptedOperator({"reading:hand": "100 200 300 90 0 0"})) as device:
            pose = (await device.measure_pose()).station_probe
        assert pose.position_m == pytest.approx((0.1, 0.2, 0.3))
        assert pose.rotation_matrix() == pytest.approx(
            np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-12
        )


class TestGrowingFile:
    async def test_the_row_written_after_the_question_is_taken(self, tmp_path: Path) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n1;2;3\n")
        async with tracker_config(path).open() as device:
            for k in range(3):
                reading = await request_point(device)
                append_text(path, f"{k},5;20;30\n")
                found = await reading
                assert found.position_m == pytest.approx((0.001 * k + 0.0005, 0.02, 0.03))
                assert found.raw == f"{k},5;20;30"

    async def test_a_file_that_the_first_shot_makes_is_waited_for(self, tmp_path: Path) -> None:
        path = tmp_path / "shots.csv"
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            append_text(path, "x;y;z\n1;2;3\n")
            assert (await reading).position_m == pytest.approx((0.001, 0.002, 0.003))

    async def test_a_row_is_not_taken_before_its_line_has_ended(self, tmp_path: Path) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n")
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            append_text(path, "1;2;12")
            await asyncio.wait({reading}, timeout=0.3)
            assert not reading.done()
            append_text(path, "3,4\n")
            assert (await reading).position_m == pytest.approx((0.001, 0.002, 0.1234))

    async def test_a_row_that_was_begun_before_the_question_is_not_new(self, tmp_path: Path) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n1;2;3")
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            append_text(path, "\n7;8;9\n")
            assert (await reading).position_m == pytest.approx((0.007, 0.008, 0.009))

    async def test_two_shots_for_one_question_are_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n")
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            append_text(path, "1;2;3\n4;5;6\n")
            with pytest.raises(RefusedError, match="2 rows were written"):
                await reading

    async def test_no_new_reading_is_reported_with_the_present_ones(self, tmp_path: Path) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n1;2;3\n4;5;6")
        async with tracker_config(path, wait_s=0.2).open() as device:
            with pytest.raises(DeviceTimeoutError, match="half written") as failure:
                await device.measure_point()
            assert "shoot after the question" in failure.value.remedy

    @pytest.mark.parametrize("now", ["x;y;z\n1;2;3\n", "x;y;z\n1;2;3\n4;5;7\n8;8;8\n", ""])
    async def test_a_file_that_shrinks_or_changes_is_reported(self, tmp_path: Path, now: str) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n1;2;3\n")
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            append_text(path, "4;5;6\n")
            await reading
            path.write_text(now, encoding="utf-8")
            with pytest.raises(RefusedError, match=r"shorter|line 3 has changed"):
                await device.measure_point()
            assert (await device.read_condition()).readiness is Readiness.NOT_READY

    @pytest.mark.parametrize("row", ["1;2;nan\n", "1;2\n", "9;9;30000\n"])
    async def test_a_row_that_is_no_reading_is_refused(self, tmp_path: Path, row: str) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n")
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            append_text(path, row)
            with pytest.raises(RefusedError, match="line 2"):
                await reading

    async def test_two_questions_at_once_are_our_bug_and_a_cancelled_one_leaves_it_usable(
        self, tmp_path: Path
    ) -> None:
        path = tmp_path / "shots.csv"
        append_text(path, "x;y;z\n")
        async with tracker_config(path).open() as device:
            reading = await request_point(device)
            with pytest.raises(BusyError):
                await device.measure_point()
            reading.cancel()
            await asyncio.wait({reading})
            append_text(path, "1;1;1\n")
            reading = await request_point(device)
            append_text(path, "2;2;2\n")
            assert (await reading).position_m == pytest.approx((0.002, 0.002, 0.002))

    @pytest.mark.parametrize("content", [b"\xff\xfex\0;\0", b"PK\x03\x04\0\0\0\0"])
    async def test_what_is_no_text_is_refused(self, tmp_path: Path, content: bytes) -> None:
        path = tmp_path / "shots.csv"
        path.write_bytes(content)
        async with tracker_config(path).open() as device:
            assert (await device.read_condition()).readiness is Readiness.NOT_READY
            with pytest.raises(RefusedError, match="UTF-8"):
                await device.measure_point()

    async def test_what_is_no_plain_file_is_refused(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        async with tracker_config(tmp_path / "pipe").open() as device:
            with pytest.raises(RefusedError, match="plain file"):
                await device.measure_point()
        async with tracker_config(tmp_path / "nowhere" / "shots.csv").open() as device:
            assert (await device.read_condition()).readiness is Readiness.UNREACHABLE
            with pytest.raises(UnreachableError):
                await device.measure_point()


class TestWholeFile:
    TEXT = "x;y;z\n1;2;3\n4;5;6\n7;8;9"

    def file_config(self, tmp_path: Path, **settings: Any) -> FileTrackerConfig:
        path = tmp_path / "all.csv"
        path.write_text(self.TEXT, encoding="utf-8")
        return tracker_config(path, source="whole_file", **settings)

    async def test_row_after_row_belongs_to_capture_after_capture(self, tmp_path: Path) -> None:
        async with self.file_config(tmp_path).open(ScriptedOperator({"first_row:hand": "1"})) as device:
            found = [(await device.measure_point()).position_m[0] for _ in range(3)]
            assert found == pytest.approx([0.001, 0.004, 0.007])
            with pytest.raises(RefusedError, match="row 4 is asked for, it has 3"):
                await device.measure_point()

    async def test_a_resumed_run_says_where_it_goes_on(self, tmp_path: Path) -> None:
        async with self.file_config(tmp_path).open(ScriptedOperator({"first_row:hand": "3"})) as device:
            assert (await device.measure_point()).position_m[0] == pytest.approx(0.007)
        async with self.file_config(tmp_path, first_row=2).open() as device:
            assert (await device.measure_point()).position_m[0] == pytest.approx(0.004)

    @pytest.mark.parametrize("row_text", ["0", "4", "two", "-1"])
    async def test_no_row_is_guessed(self, tmp_path: Path, row_text: str) -> None:
        async with self.file_config(tmp_path).open(ScriptedOperator({"first_row:hand": row_text})) as device:
            with pytest.raises(RefusedError):
                await device.measure_point()
        async with self.file_config(tmp_path).open() as device:
            with pytest.raises(RefusedError, match="first_row"):
                await device.measure_point()

    async def test_a_file_that_changes_under_way_is_reported(self, tmp_path: Path) -> None:
        config = self.file_config(tmp_path, first_row=1)
        async with config.open() as device:
            await device.measure_point()
            (tmp_path / "all.csv").write_text(self.TEXT.replace("4;5;6", "4;5;6,1"), encoding="utf-8")
            with pytest.raises(RefusedError, match="line 3 has changed"):
                await device.measure_point()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"source": "growing_file"}, "needs a path"),
        ({"source": "growing_file", "path": "shots.csv", "columns": [1]}, "whole path"),
        ({"source": "growing_file", "path": "/x.csv", "columns": [1, 2]}, "1 columns"),
        ({"source": "growing_file", "path": "/x.csv", "columns": [0]}, "counted from 1"),
        ({"unit": "furlong"}, "unit"),
        ({"sigma_m": float("nan")}, "finite"),
    ],
)
def test_a_cell_file_that_says_too_little_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        gauge_config(**settings)
