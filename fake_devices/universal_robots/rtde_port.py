"""Port 30004: real-time data exchange with any number of clients.

Imitates
    The RTDE server of the controller.
Source
    The maker's RTDE guide; the handshakes of ur_rtde 1.6.5 and of the maker's Python client.
Modelled
    Protocol 1 and 2, the handshake in any order, one output recipe and up to 255 input recipes per client,
    frequencies that divide the base rate, IN_USE, NOT_FOUND.
Not modelled
    Several output recipes of one client (a new one replaces the old); text messages to clients without fault.
"""

import logging
import struct
from typing import Any

from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.ports import PortConnection, TcpPort
from cellcal.fake_devices.universal_robots.readings import OutputVariables
from cellcal.fake_devices.universal_robots.rtde import (
    MAX_NAME_BYTES,
    DataPacker,
    InputRecipe,
    OutputRecipe,
    PackageType,
    TelegramSplitter,
    make_message,
    make_telegram,
    names_in,
)
from cellcal.fake_devices.universal_robots.rtde_fields import INPUT_TYPES, OUTPUT_TYPES

_log = logging.getLogger(__name__)
_PROTOCOL_1_HZ = 125.0
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"


class RtdeServer:
    """The state that all RTDE clients share."""

    def __init__(self, controller: UrController) -> None:
        self.controller = controller
        self.readings = OutputVariables(controller)
        self.hidden_names: set[str] = set()
        self.frozen = False
        self.clients: set[RtdeConnection] = set()

    @property
    def fastest_hz(self) -> float:
        """Return the highest rate that a started client asked for; 0 without clients."""
        rate = self.controller.identity.base_rate_hz
        return max((rate / client.every for client in self.clients if client.started), default=0.0)

    @property
    def longest_turn(self) -> int:
        """Return every how many controller steps the slowest started client gets a package."""
        return max((client.every for client in self.clients if client.started), default=1)

    def publish_state(self, step: int, previous: int) -> None:
        """Send the present state to every client whose turn came between two controller steps."""
        for client in list(self.clients):
            client.publish_state(step, previous)


class RtdeConnection(PortConnection):
    """One RTDE client."""

    def __init__(self, port: TcpPort, server: RtdeServer) -> None:
        super().__init__(port)
        self.started = False
        self.every = 1
        self._server, self._controller = server, server.controller
        self._telegrams = TelegramSplitter()
        self._protocol = 1
        self._packer: DataPacker | None = None
        self._last = b""
        self._inputs: dict[int, InputRecipe] = {}
        self._answers = {
            PackageType.PROTOCOL: self._negotiate_protocol,
            PackageType.VERSION: self._answer_version,
            PackageType.OUTPUTS: self._set_up_outputs,
            PackageType.INPUTS: self._set_up_inputs,
            PackageType.START: self._start_output,
            PackageType.PAUSE: self._pause_output,
        }

    def send_greeting(self) -> None:
        self._server.clients.add(self)

    def on_disconnect(self) -> None:
        self._server.clients.discard(self)
        self._controller.registers.release_names(self)

    def on_bytes(self, data: bytes) -> None:
        for kind, payload in self._telegrams.split_telegrams(data):
            if kind == PackageType.DATA:
                self._take_inputs(payload)
            elif kind == PackageType.MESSAGE:
                _log.info("RTDE client says %r", payload)
            else:
                self._answer_package(kind, payload)

    def _answer_package(self, kind: int, payload: bytes) -> None:
        try:
            act = self._answers[PackageType(kind)]
        except ValueError:
            self.send(make_message(f"Unsupported package type {kind}", level=1, protocol=self._protocol))
            return
        self.send(make_telegram(kind, act(payload)))

    def _negotiate_protocol(self, payload: bytes) -> bytes:
        version = struct.unpack(">H", payload)[0] if len(payload) == 2 else 0
        if version not in (1, 2):
            return b"\0"
        self._protocol = version
        return b"\1"

    def _answer_version(self, _payload: bytes) -> bytes:
        return struct.pack(">IIII", *self._controller.identity.version)

    def _set_up_outputs(self, payload: bytes) -> bytes:
        frequency_hz, names = _PROTOCOL_1_HZ, payload
        if self._protocol > 1:
            if len(payload) < 8:
                return b"\0"
            frequency_hz, names = struct.unpack_from(">d", payload)[0], payload[8:]
        recipe_id, kinds = self._output_recipe(frequency_hz, names_in(names[:MAX_NAME_BYTES]))
        listed = ",".join(kinds).encode()
        return listed if self._protocol == 1 else bytes([recipe_id]) + listed

    def _output_recipe(self, frequency_hz: float, names: list[str]) -> tuple[int, list[str]]:
        getters = [
            None if name in self._server.hidden_names else self._server.readings.getter_for(name)
            for name in names
        ]
        kinds = [
            OUTPUT_TYPES[name] if get is not None else NOT_FOUND
            for name, get in zip(names, getters, strict=True)
        ]
        found = tuple(get for get in getters if get is not None)
        self.started, self._packer, self._last = False, None, b""
        if len(found) != len(names) or not names:
            return 0, kinds
        base_hz = self._controller.identity.base_rate_hz
        self.every = max(1, round(base_hz / min(max(frequency_hz, 1.0), base_hz)))
        recipe_id = None if self._protocol == 1 else 1
        self._packer = DataPacker(OutputRecipe(tuple(kinds), found, self.every, recipe_id))
        return 1, kinds

    def _set_up_inputs(self, payload: bytes) -> bytes:
        names = names_in(payload[:MAX_NAME_BYTES])
        hidden = self._server.hidden_names
        kinds = [NOT_FOUND if name in hidden else INPUT_TYPES.get(name, NOT_FOUND) for name in names]
        taken: set[str] = set()
        if NOT_FOUND not in kinds:
            taken = set(self._controller.registers.claim_names(names, self))
        kinds = [IN_USE if name in taken else kind for name, kind in zip(names, kinds, strict=True)]
        recipe_id = 0
        if names and len(self._inputs) < 255 and not {NOT_FOUND, IN_USE} & set(kinds):
            recipe_id = len(self._inputs) + 1
            self._inputs[recipe_id] = InputRecipe(tuple(names), tuple(kinds))
        return bytes([recipe_id]) + ",".join(kinds).encode()

    def _start_output(self, _payload: bytes) -> bytes:
        self.started = self._packer is not None
        return bytes([self.started])

    def _pause_output(self, _payload: bytes) -> bytes:
        self.started = False
        return b"\1"

    def _take_inputs(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        values: dict[str, Any] | None = recipe.unpack_values(payload[1:]) if recipe is not None else None
        if values is None:
            _log.warning("RTDE data package of %d bytes fits no input recipe: ignored", len(payload))
            return
        self._controller.apply_inputs(values)

    def publish_state(self, step: int, previous: int) -> None:
        """Send the recipe if its turn came; the next one is not late for it."""
        if self.started and self._packer is not None and step // self.every > previous // self.every:
            if not self._server.frozen or not self._last:
                self._last = self._packer.data_telegram()
            self.send(self._last)
