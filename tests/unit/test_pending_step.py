"""A step that was ordered just before a stop is given up: it neither runs later nor counts as the next one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from cellcal.drivers.abb.robot_web_services.motion_server import MotionServer as AbbMotionServer
from cellcal.drivers.errors import RefusedError
from cellcal.drivers.kuka.variables.motion_server import MotionServer as KukaMotionServer
from cellcal.fake_devices.abb_web_services.controller import AbbController
from cellcal.fake_devices.kuka_variables.controller import KukaController
from cellcal.fake_devices.kuka_variables.variables import VariableTable
from cellcal.fake_devices.shown_joints import ShownJoints
from cellcal.fake_devices.world import World

MODEL = "fanuc_m6ib"  # the program does not care
FIRST = (0.4, -0.5, 0.6, 0.1, 0.3, 0.1)
SECOND = (-0.2, -0.6, 0.7, 0.1, 0.3, 0.1)


class SimulatedProgram:
    """A simulated controller whose program runs some cycles per exchange with the driver."""

    def __init__(self, brand: str, exchanges_per_cycle: int) -> None:
        world = World(hidden=False)
        self.arm = world.add_arm("robot", MODEL)
        self.motion: Any
        shown = ShownJoints(self.arm, (100.0,) * 6, np.random.default_rng(1))
        self._clock, self._exchanges, self._each = world.clock, 0, exchanges_per_cycle
        if brand == "abb":
            abb = AbbController(self.arm, "0", self.passed_s, shown)
            self._run_cycle: Callable[[], None] = abb.run_program
            self.motion = AbbMotionServer(AbbLink(self, abb))  # type: ignore[arg-type]
        else:
            kuka = KukaController(self.arm, ("0", "KR"), self.passed_s, shown)
            self._run_cycle = kuka.run_programs
            self.motion = KukaMotionServer(KukaLink(self, VariableTable(kuka)))  # type: ignore[arg-type]

    def passed_s(self) -> float:
        """Return the time that the exchanges took."""
        return 0.02 * self._exchanges

    def exchange(self) -> None:
        """Let the time of one exchange go by."""
        self._clock.advance(0.02)
        self._exchanges += 1
        if self._exchanges % self._each == 0:
            self._run_cycle()

    async def order(self, joints_rad: tuple[float, ...]) -> int:
        """Order a step that takes many exchanges: two seconds, or two per cent of the speed."""
        return int(await self.motion.order_move(joints_rad, 2))


class AbbLink:
    """What the driver uses of its link to Robot Web Services."""

    device = "abb"

    def __init__(self, program: SimulatedProgram, controller: AbbController) -> None:
        self._program, self._controller = program, controller

    async def read_symbol(self, name: str) -> str:
        self._program.exchange()
        value = self._controller.read_symbol(name)
        assert value is not None
        return value

    async def write_symbol(self, name: str, value: str) -> None:
        self._program.exchange()
        assert self._controller.write_symbol(name, value)


class KukaLink:
    """What the driver uses of its link to the variable server."""

    device = "kuka"

    def __init__(self, program: SimulatedProgram, variables: VariableTable) -> None:
        self._program, self._variables = program, variables

    async def read_variable(self, variable: str) -> str:
        self._program.exchange()
        text = self._variables.read(variable)
        assert text is not None
        return text

    async def write_variable(self, variable: str, value: str) -> None:
        self._program.exchange()
        assert self._variables.write(variable, value)


@pytest.mark.parametrize("exchanges_per_cycle", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("polls", range(4))
@pytest.mark.parametrize("brand", ["abb", "kuka"])
async def test_a_step_ordered_before_a_stop_is_given_up(
    brand: str, polls: int, exchanges_per_cycle: int
) -> None:
    program = SimulatedProgram(brand, exchanges_per_cycle)
    await program.motion.require_running()
    request = await program.order(FIRST)
    for _ in range(polls):
        await program.motion.has_finished(request)
    await program.motion.stop()
    for _ in range(50):
        program.exchange()
    stood_at = program.arm.joints_rad.copy()
    await program.motion.require_running()
    for _ in range(50):
        program.exchange()
    assert not program.arm.is_moving
    assert program.arm.joints_rad == pytest.approx(stood_at, abs=1e-12), "the old step ran after the release"
    request = await program.order(SECOND)
    while not await program.motion.has_finished(request):
        pass
    assert np.degrees(program.arm.joints_rad) == pytest.approx(np.degrees(SECOND), abs=1e-4)


@pytest.mark.parametrize("brand", ["abb", "kuka"])
async def test_a_pending_step_of_an_older_program_refuses_the_next(
    brand: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = SimulatedProgram(brand, 1)

    async def read_pending_request() -> int:
        return 77

    monkeypatch.setattr(program.motion, "_read_request", read_pending_request)
    with pytest.raises(RefusedError, match="does not run"):
        await program.motion.require_running()
