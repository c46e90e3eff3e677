"""Port 29999: commands for people and for PLCs, one line each.

Imitates
    The dashboard server of PolyScope 3 and 5.
Source
    The maker's dashboard server page for the e-Series; what ur_rtde 1.6.5 expects word for word; the first software
    of each command as the maker's C++ client library 2.14.0 has it.
Modelled
    The commands of that table, those that the software version has; remote and local control, which CB3 lacks.
Not modelled
    User roles, installations, generating support files; programs on the controller's disk have no content.
"""

from collections.abc import Callable

from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.ports import PortConnection, TcpPort
from cellcal.fake_devices.universal_robots.states import RuntimeState, SafetyMode

_GREETING = "Connected: Universal Robots Dashboard Server"
_FIXED = {
    "close popup": "closing popup",
    "close safety popup": "closing safety popup",
    "restart safety": "Restarting safety",
    "shutdown": "Shutting down",
}
_LOCAL_REFUSAL = "Command is not allowed due to safety reasons. The robot is not in remote control mode"
_REMOTE_ONLY = frozenset(
    {"play", "stop", "pause", "power on", "power off", "brake release", "unlock protective stop", "shutdown"}
)
_STATES = {RuntimeState.PLAYING: "PLAYING", RuntimeState.PAUSED: "PAUSED"}
_NEVER = (4, 0)
_SINCE = {  # first software of the CB3 and of the e-Series, where it is not the first there was
    "get serial number": ((3, 12), (5, 6)),
    "get robot model": ((3, 12), (5, 6)),
    "is in remote control": (_NEVER, (5, 6)),
    "safetystatus": (_NEVER, (5, 4)),
    "restart safety": ((3, 7), (5, 1)),
}


class DashboardConnection(PortConnection):
    """One dashboard client."""

    def __init__(self, port: TcpPort, controller: UrController) -> None:
        super().__init__(port)
        self._c = controller
        self._rest = b""
        self._commands = self._question_commands() | self._order_commands()

    def send_greeting(self) -> None:
        self._send_line(_GREETING)

    def on_bytes(self, data: bytes) -> None:
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            text = line.decode("utf-8", "replace").strip()
            if text == "quit":
                self._send_line("Disconnected")
                self.finish()
                return
            self._send_line(self._reply_to(text))

    def _send_line(self, text: str) -> None:
        self.send(text.encode() + b"\n")

    def _reply_to(self, text: str) -> str:
        if text in _SINCE and not self._has_command(text):
            return f"could not understand: '{text}'"
        if text in _REMOTE_ONLY and not self._c.remote:
            return _LOCAL_REFUSAL
        if text in self._commands:
            return self._commands[text]()
        if text in _FIXED:
            return _FIXED[text]
        word, _, rest = text.partition(" ")
        if word == "load":
            self._c.loaded_program = rest
            return f"Loading program: {rest}"
        answers = {
            "popup": "showing popup",
            "addToLog": "Added log message",
            "setUserRole": "Setting user role",
        }
        return answers.get(word, f"could not understand: '{text}'")

    def _has_command(self, text: str) -> bool:
        identity = self._c.identity
        old, new = _SINCE[text]
        return identity.version[:2] >= (old if identity.is_cb3 else new)

    def _question_commands(self) -> dict[str, Callable[[], str]]:
        c = self._c
        return {
            "PolyscopeVersion": lambda: c.identity.software_text,
            "version": lambda: c.identity.software_text,
            "get serial number": lambda: c.identity.serial,
            "get robot model": lambda: c.identity.model_family,
            "is in remote control": lambda: str(c.remote).lower(),
            "robotmode": lambda: f"Robotmode: {c.robot_mode.name}",
            "safetymode": lambda: f"Safetymode: {c.safety_mode.name}",
            "safetystatus": lambda: f"Safetystatus: {c.safety_mode.name}",
            "programState": lambda: f"{_STATES.get(c.runtime, 'STOPPED')} {c.loaded_program}",
            "running": lambda: f"Program running: {str(c.runtime is RuntimeState.PLAYING).lower()}",
            "isProgramSaved": lambda: f"true {c.loaded_program}",
            "get loaded program": lambda: f"Loaded program: {c.loaded_program}",
        }

    def _order_commands(self) -> dict[str, Callable[[], str]]:
        return {
            "play": self._play_program,
            "stop": self._stop_program,
            "pause": self._pause_program,
            "power on": lambda: self._switch_power(on=True),
            "power off": lambda: self._switch_power(on=False),
            "brake release": self._release_brakes,
            "unlock protective stop": self._unlock_stop,
        }

    def _play_program(self) -> str:
        return "Starting program" if self._c.resume_program() else "Failed to execute: play"

    def _stop_program(self) -> str:
        self._c.end_program()
        return "Stopped"

    def _pause_program(self) -> str:
        return "Pausing program" if self._c.pause_program() else "Failed to execute: pause"

    def _switch_power(self, *, on: bool) -> str:
        self._c.switch_power(on=on)
        return "Powering on" if on else "Powering off"

    def _release_brakes(self) -> str:
        self._c.release_brakes()
        return "Brake releasing"

    def _unlock_stop(self) -> str:
        if self._c.unlock_protective_stop():
            return "Protective stop releasing"
        if self._c.safety_mode is SafetyMode.PROTECTIVE_STOP:
            return (
                "Cannot unlock protective stop until 5s after occurrence."
                " Always inspect cause of protective stop before unlocking"
            )
        return "Cannot unlock: no protective stop"
