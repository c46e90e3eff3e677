"""A simulated KUKA or ABB controller that executes the sources that ship, without a driver and without real time."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellcal.fake_devices.abb_web_services.controller import AbbController
from cellcal.fake_devices.abb_web_services.program import SOURCES as RAPID_SOURCES
from cellcal.fake_devices.abb_web_services.program import RapidPrograms
from cellcal.fake_devices.kuka_variables.controller import KukaController
from cellcal.fake_devices.kuka_variables.program import BOTH, CELLCAL, KrlPrograms
from cellcal.fake_devices.kuka_variables.program import SOURCES as KRL_SOURCES
from cellcal.fake_devices.kuka_variables.variables import VariableTable
from cellcal.fake_devices.shown_joints import ShownJoints
from cellcal.fake_devices.world import World

BRANDS = ("kuka", "abb")
NAMES = {
    "kuka": ("CC_REQ", "CC_ACK", "CC_STATE", "CC_STOP", "CC_HB", "CC_AXIS", "CC_LIFE"),
    "abb": tuple(
        f"CellcalServer/{name}" for name in ("nReq", "nAck", "nState", "nStop", "nHeart", "jTarget", "nLife")
    ),
}
CYCLE_S = 0.004
CLOSE_DEG = (3.0, -2.0, 2.0, 1.0, 2.0, 1.0)
BACK_DEG = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NEAR_DEG = (10.0, -10.0, 10.0, 5.0, 30.0, 5.0)
FAR_DEG = (40.0, -20.0, 20.0, 5.0, 30.0, 5.0)
BEYOND_DEG = (400.0, -20.0, 20.0, 5.0, 30.0, 5.0)


class ProgramBench:
    """One controller with its program; time goes by only with its cycles."""

    def __init__(
        self, brand: str, *, at_once: int = 500, folder: Path | None = None, program: str = CELLCAL
    ) -> None:
        self.world = World(time_factor=0.0, hidden=False)
        self.arm = self.world.add_arm("robot", "fanuc_m6ib")
        shown = ShownJoints(self.arm, (100.0,) * 6, np.random.default_rng(1))
        self.brand, self.now_s = brand, 0.0
        self.kuka = self.abb = None
        if brand == "kuka":
            krl = KrlPrograms(folder or KRL_SOURCES, program, at_once)
            self.kuka = KukaController(self.arm, ("0", "KR"), self.passed_s, shown, krl)
            table = VariableTable(self.kuka)
            self.read: Callable[[str], str | None] = table.read
            self.write: Callable[[str, str], bool] = table.write
            self.run: Callable[[], None] = self.kuka.run_programs
        else:
            rapid = RapidPrograms(folder or RAPID_SOURCES, program == BOTH, at_once)
            self.abb = AbbController(self.arm, "0", self.passed_s, shown, rapid)
            self.read, self.write, self.run = (
                self.abb.read_symbol,
                self.abb.write_symbol,
                self.abb.run_program,
            )
        names = NAMES[brand]
        self.req, self.ack, self.state, self.stop, self.heart, self.target, self.life = names
        self.beat = 0
        self.is_alive = True

    def passed_s(self) -> float:
        return self.now_s

    def number(self, name: str) -> int:
        text = self.read(name)
        assert text is not None
        return int(float(text))

    def cycles(self, count: int) -> None:
        for _ in range(count):
            self.now_s += CYCLE_S
            self.world.clock.advance(CYCLE_S)
            if self.is_alive:
                self.beat = self.beat % 30_000 + 1
                assert self.write(self.heart, str(self.beat))
            self.run()

    def until(self, condition: Callable[[], bool], most_s: float = 60.0) -> float:
        """Run until a condition holds; return how long it took."""
        began_s = self.now_s
        while not condition():
            assert self.now_s - began_s < most_s, "it has not come so far"
            self.cycles(1)
        return self.now_s - began_s

    def write_target(self, joints_deg: tuple[float, ...]) -> None:
        if self.brand == "kuka":
            axes = ", ".join(f"A{axis} {value}" for axis, value in enumerate(joints_deg, 1))
            assert self.write(self.target, f"{{E6AXIS: {axes}}}")
        else:
            assert self.write(self.target, f"[[{','.join(map(str, joints_deg))}],[{','.join(['9E9'] * 6)}]]")

    def order(self, number: int, joints_deg: tuple[float, ...]) -> None:
        self.write_target(joints_deg)
        assert self.write(*(("CC_VEL", "10") if self.brand == "kuka" else ("CellcalServer/nTime", "2")))
        assert self.write(self.req, str(number))

    @property
    def sends_joints(self) -> bool:
        if self.kuka is not None:
            return self.kuka.programs.sensor_runs
        assert self.abb is not None
        return self.abb.server.task.streams

    def turn_override(self, percent: int) -> None:
        if self.kuka is not None:
            self.kuka.set_override(percent)
        if self.abb is not None:
            self.abb.set_speed(percent)

    def turn_mode_switch(self) -> None:
        if self.kuka is not None:
            self.kuka.mode = "T1"
        if self.abb is not None:
            self.abb.turn_mode_switch("MANR")

    def set_stop(self, *, on: bool) -> None:
        words = ("TRUE", "FALSE") if self.brand == "kuka" else ("1", "0")
        assert self.write(self.stop, words[0 if on else 1])

    def until_waiting(self) -> None:
        self.until(lambda: self.number(self.state) == 1)

    def joints_deg(self) -> list[float]:
        return [float(value) for value in np.degrees(self.arm.joints_rad)]

    def pause(self) -> None:
        if self.kuka is not None:
            self.kuka.open_gate()
        if self.abb is not None:
            self.abb.press_emergency_stop()

    def press_start(self) -> None:
        if self.kuka is not None:
            self.kuka.mode = "AUT"
            self.kuka.acknowledge()
            self.kuka.programs.robot.press_start()
        if self.abb is not None:
            self.abb.turn_to_auto()

    def start_anew(self) -> None:
        if self.kuka is not None:
            self.kuka.mend()
        if self.abb is not None:
            self.abb.mend()

    def carry_out(self, number: int, joints_deg: tuple[float, ...]) -> None:
        """Order a step and wait for its end, as a client does."""
        self.order(number, joints_deg)
        self.until(lambda: self.number(self.ack) == number and self.number(self.state) == 1)
        assert self.joints_deg() == pytest.approx(joints_deg, abs=1e-4)


def damaged(folder: Path, source: Path, removed: str) -> Path:
    """Copy the sources with the first of some words taken out."""
    for file in source.iterdir():
        text = file.read_text(encoding="ascii")
        (folder / file.name).write_text(text.replace(removed, "", 1), encoding="ascii")
    return folder
