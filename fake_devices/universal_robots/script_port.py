"""Ports that take programs: 30003, and 30001 and 30002 which also talk.

Imitates
    Program upload over the network.
Source
    The maker's client interface page; README of this package, upload.
Modelled
    A program replaces the running one; it is ignored in local control and while stopped for safety; it can be
    told to start late.
Not modelled
    The state stream of 30003: ur_rtde never reads it, and a full buffer would stop the controller.
"""

import logging

from cellcal.fake_devices.universal_robots.commands import ACTS
from cellcal.fake_devices.universal_robots.control_script import ControlScript, ForeignProgram
from cellcal.fake_devices.universal_robots.controller import RunningProgram, UrController
from cellcal.fake_devices.universal_robots.ports import PortConnection, TcpPort
from cellcal.fake_devices.universal_robots.programs import ProgramSplitter, parse_program

_log = logging.getLogger(__name__)


class ProgramLoader:
    """Turns texts into running programs."""

    def __init__(self, controller: UrController) -> None:
        self.start_delay_s = 0.0
        self._controller = controller
        self._waiting: list[tuple[float, RunningProgram]] = []

    def load_program(self, text: str) -> None:
        """Start a program, now or after the delay."""
        program = parse_program(text)
        running: RunningProgram
        if program.is_control_script:
            running = ControlScript(self._controller, program, ACTS)
        else:
            running = ForeignProgram(self._controller, program)
        _log.info("program %s, register offset %d", program.name, program.register_offset)
        self._waiting.append((self._controller.timestamp_s + self.start_delay_s, running))

    def start_due(self) -> None:
        """Start what is due."""
        while self._waiting and self._waiting[0][0] <= self._controller.timestamp_s:
            self._controller.start_program(self._waiting.pop(0)[1])


class ScriptConnection(PortConnection):
    """A client that uploads programs."""

    def __init__(self, port: TcpPort, loader: ProgramLoader) -> None:
        super().__init__(port)
        self._loader = loader
        self._programs = ProgramSplitter()

    def on_bytes(self, data: bytes) -> None:
        for text in self._programs.split_programs(data):
            self._loader.load_program(text)
