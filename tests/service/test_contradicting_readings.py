"""A watch in the cell's process says on the page when two readings of the encoders contradict each other."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service.cell_process.loss_watch import LossWatch
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from tests.unit.test_watch import TwoAxisController


async def test_readings_that_contradict_each_other_are_a_trouble_and_no_loss(
    tmp_path: Path,
) -> None:
    config = read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0))
    answers = iter([(1000, 2000), (1000, 2000), (9 * 524288 * 100, 2000), (1000, 2000), (1000, 2000)])
    arm = TwoAxisController(name="fanuc")

    async def read_counts() -> tuple[int, ...]:
        return next(answers)

    arm.encoder_counts = read_counts  # type: ignore[method-assign]
    watch = LossWatch(config, lambda _: None, lambda _: "")
    cell: Any = SimpleNamespace(robot=arm)
    for look in range(3):
        assert await watch.check_robot(cell, now_s=1000.0 * look, busy=False) is None
        troubles = [(trouble.task, "contradict" in trouble.message) for trouble in SUPERVISOR.list_troubles()]
        assert troubles == ([("watch of fanuc", True)] if look else [])
    assert watch.as_json() == []
