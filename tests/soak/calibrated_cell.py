"""A fake robot, draw-wire and tracker behind real drivers and sockets, to be calibrated; and the truth of it."""

import os
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from cellcal.calibration.arm.joint_terms import term_values
from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.identification.free_parameters import StartingPoint, starting_state
from cellcal.calibration.mastering.pose_design import candidate_joints
from cellcal.calibration.motion.motion_check import MotionLimits, WirePath
from cellcal.calibration.poses.calibrated_arm import CalibratedArm
from cellcal.calibration.registration import best_fit_transform
from cellcal.fake_devices.cell import FakeCell
from cellcal.procedures.cell import Cell
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.runs.open_cell import open_cell
from cellcal.service.runs.settings import build_spec
from tests.cell_tables import (
    cell_head,
    draw_wire_table,
    fake_table,
    fanuc_table,
    fill_in,
    tracker_table,
    write_table,
)
from tests.procedures.ideal_devices import ScriptedTechnician

ANCHOR, HOOK = (0.9, -0.7, -0.45), (0.06, 0.05, 0.12)
POSTURES = 300
WARM_GROWTH, LOST_ZERO_RAD = 2e-4, 0.0025  # some 16 K; a seventh of a degree
_TARGETS = {
    "wire": ("hook_in_flange_m", "anchor_in_base_m"),
    "tracker": ("flange_probe", "base_tracker"),
}
_numbers = count()


@dataclass(frozen=True)
class CalibrationBench:
    """A cell as procedures see it, and the world behind it."""

    cell: Cell
    fake: FakeCell
    config: CellConfig
    technician: ScriptedTechnician

    def hang_at_targets(self) -> None:
        """Let the technician put hook or reflector where an instruction wants it, as long as this cell is open."""
        wire: Any = self.fake.gauges[0]
        tracker: Any = self.fake.trackers[0]
        holes, home = self.fake.world.end_effector, tracker.sensor.flange_probe.copy()
        assert holes is not None

        def hang_wire(number: int) -> None:
            if number:
                wire.gauge.hook_to(number)
                tracker.sensor.flange_probe = homogeneous_matrix(home[:3, :3], holes.hole_in_flange(number))
            else:
                wire.gauge.go_home()
                tracker.sensor.flange_probe = home

        for number in range(1, 1 + len(holes.targets_m)):
            for key in ("hook_wire", "target_to_point"):
                self.technician.does[f"{key}_{number}"] = lambda number=number: hang_wire(number)
        self.technician.does["hook_wire_back"] = self.technician.does["target_back"] = lambda: hang_wire(0)

    def flange_tool(self) -> np.ndarray:
        """Return where the tool truly is in the flange that the arm's last axis and its zero define, (4, 4)."""
        wire: Any = self.fake.gauges[0]
        return np.asarray(wire.gauge.tool_in_flange())

    def build_spec(self, procedure: str, **settings: Any) -> Any:
        """Return a procedure's spec as the service makes it: it knows what stands in the cell."""
        return build_spec(self.config, "fanuc", procedure, settings)

    def let_happen(self, what: str, method: str) -> Callable[[], None]:
        """Let one thing happen to the robot; return what takes it back."""
        arm, hidden = self.fake.world.arms["fanuc"], self.fake.world.arms["fanuc"].hidden
        seen_by: Any = self.fake.gauges[0] if method == "wire" else self.fake.trackers[0]
        device = seen_by.gauge if method == "wire" else seen_by.sensor
        target, stand = _TARGETS[method]
        before = {name: getattr(device, name).copy() for name in (target, stand)}
        if what == "tool":
            knocked = before[target].copy()
            place = knocked if method == "wire" else knocked[:3, 3]
            place += np.array([0.0012, -0.001, 0.0006])
            setattr(device, target, knocked)
        elif what == "device" and method == "wire":
            setattr(device, stand, before[stand] + np.array([0.001, 0.0012, 0.0015]))
        elif what == "device":
            setattr(
                device,
                stand,
                homogeneous_matrix(np.eye(3), np.array([0.001, -0.0005, 0.0008])) @ before[stand],
            )
        elif what == "warmth":
            changes = np.zeros((6, 5))
            changes[:, 1:3] = WARM_GROWTH * arm.true_dh[:, 1:3]
            arm.bend_links(changes)
        elif what.startswith("J"):
            changes = np.zeros((6, 5))
            changes[:, 0] = LOST_ZERO_RAD * arm.coupling[:, int(what[1:]) - 1]
            arm.bend_links(changes)

        def undo_fault() -> None:
            arm.hidden = hidden
            for name, value in before.items():
                setattr(device, name, value)

        return undo_fault

    def target_m(self, method: str) -> np.ndarray:
        """Return where the hook or the reflector truly is on the flange [m]."""
        if method == "wire":
            return np.asarray(self.fake.world.hooks_in_flange_m["fanuc"])
        device: Any = self.fake.trackers[0]
        return np.asarray(device.sensor.target_in_flange_m)

    def targets_m(self, joints_rad: np.ndarray, hook_m: np.ndarray) -> np.ndarray:
        """Return where a point of the flange truly is."""
        flanges = self.fake.world.arms["fanuc"].flange_at(joints_rad)
        return (flanges @ [*hook_m, 1.0])[:, :3]


@asynccontextmanager
async def cell_behind_sockets(
    folder: Path, seed: int, *, time_factor: float = 2000.0
) -> AsyncIterator[CalibrationBench]:
    """Play the devices in this process, connect to them over loopback, and yield the cell."""
    path, pid = folder / f"cell_{seed}.toml", os.getpid()
    address = f"127.{60 + next(_numbers) % 60}.{pid >> 8 & 0xFF}.{pid & 0xFF}"
    text = fill_in(_write_cell(seed, time_factor), folder=str(folder), address=address)
    path.write_text(text, encoding="utf-8")
    config = read_cell_file(path)
    technician = ScriptedTechnician()
    async with FakeCell.from_file(path) as fake, open_cell(config, technician) as cell:
        yield CalibrationBench(cell, fake, config, technician)


def _write_cell(seed: int, time_factor: float) -> str:
    return "".join(
        (
            cell_head("calibrations"),
            fanuc_table(deadline_s=10.0),
            draw_wire_table(sigma_m=0.0001, deadline_s=10.0),
            tracker_table(name="at"),
            write_table(
                "fake.end_effector",
                targets_mm=[[0.0, 0.0, 0.0], [160.0, 0.0, -50.0], [0.0, 160.0, -50.0]],
                flange_tool=[0.0, 0.0, 200.0, 0.0, 0.0, 0.0],
            ),
            fake_table(seed=seed, time_factor=time_factor),
        )
    )


WORK, FRAME = 977, 4242  # draws of postures: those that are judged, and those that a user frame is set by


def work_postures(draw: int) -> np.ndarray:
    """Return postures over the whole work of the wire, that no plan has drawn."""
    wire = WirePath(ANCHOR, HOOK, 3.0, lowest_fraction=0.08, highest_fraction=0.92)
    return candidate_joints(
        load_model("fanuc_m6ib"), MotionLimits(wire=wire), POSTURES, seed=draw, hook_in_flange_m=HOOK
    )


def errors_m(bench: CalibrationBench, arm: CalibratedArm, hook_m: np.ndarray) -> np.ndarray:
    """Return by how much the target misses, over the work, where an identified arm says it is.

    The user frame in which that is looked at is set at other postures than those that are judged.
    """
    set_by, judged = (
        (stated_target_m, bench.targets_m(at, hook_m))
        for at, stated_target_m in _stated_targets(arm, (FRAME, WORK))
    )
    frame = best_fit_transform(set_by[0].tolist(), set_by[1].tolist()).target_source.to_matrix()
    stated_target_m, true = judged
    return np.linalg.norm(stated_target_m @ frame[:3, :3].T + frame[:3, 3] - true, axis=1)


def _stated_targets(arm: CalibratedArm, draws: Iterable[int]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield postures of each draw, and where the identified arm says that its target is there."""
    start = StartingPoint(arm.parameter_values())
    tool = homogeneous_matrix(np.eye(3), np.array(arm.target_in_flange_m))
    state = starting_state(load_model(arm.model), start, (), tool, ())
    for joints_rad in map(work_postures, draws):
        moved = state.moved_joints(joints_rad, term_values(state.nominal, joints_rad, state.terms))
        yield joints_rad, (state.arm_model.base_flange(moved) @ state.flange_tool)[:, :3, 3]
