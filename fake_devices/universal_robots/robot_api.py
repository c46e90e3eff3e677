"""The Robot API of PolyScope X: JSON over plain HTTP, in place of the dashboard.

Imitates
    The Robot API of software 10.11 and later.
Source
    The maker's C++ client library 2.14.0 (its Robot API client, that client's tests and its page in the manual):
    paths, keys, the values of modes and states, one answer in full, and which version brought what.
Modelled
    openapi.json with the version; power, brakes, protective stop; play, pause, resume, stop; the loaded program;
    robot, safety, control and operational mode. Before 3.1.4 the modes and the loaded program cannot be read, and
    a program is loaded by another path. From 5.0.107 on serial number and model (as that library's development
    after 2.14.0 asks for them). Keep-alive, several requests in one segment, requests in pieces.
Not modelled
    Programs as files; redirects other than the fault ``api_moved``. Assumed, for lack of a source: status 403 in
    local control, 409 for an order that the present state forbids, the mode LOCAL, the words of messages.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

from cellcal.fake_devices.universal_robots.controller import UrController
from cellcal.fake_devices.universal_robots.ports import PortConnection, TcpPort
from cellcal.fake_devices.universal_robots.states import RuntimeState, SafetyMode

DEFAULT_PORT = 80
BASE = "/universal-robots/robot-api"
_MOVED = "/universal-robots/moved-robot-api"
_WHOLE, _WITH_PLATE = ("3.1.4", "5.0.107"), "5.0.107"
_MOST_BYTES = 1 << 20
_REASONS = {200: "OK", 307: "Temporary Redirect", 400: "Bad Request", 403: "Forbidden", 404: "Not Found"}
_REASONS |= {409: "Conflict", 500: "Internal Server Error"}
_STATES = {RuntimeState.PLAYING: "PLAYING", RuntimeState.PAUSED: "PAUSED"}
_EMERGENCY = (SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP)

JsonReply = tuple[int, dict[str, Any]]


class RobotApi:
    """The answers to requests; all connections share it."""

    def __init__(self, controller: UrController) -> None:
        self._c = controller
        self.refuses_orders = False
        self.moved = False
        self.broken_answer: str | None = None
        self._whole = controller.identity.robot_api_version in _WHOLE
        self._questions = self._question_paths()
        self._orders: dict[str, Callable[[Mapping[str, Any]], JsonReply]] = {
            "/robotstate/v1/state": self._change_robot_state,
            "/program/v1/state": self._change_program_state,
            "/program/v1/loaded" if self._whole else "/program/v1/load": self._load_program,
        }

    def reply_to(self, method: str, path: str, body: bytes) -> JsonReply:
        """Return status and body."""
        if self.moved and path.startswith(BASE):
            return 307, {"location": _MOVED + path.removeprefix(BASE)}
        path = path.replace(_MOVED, BASE, 1)
        if not path.startswith(BASE):
            return 404, {"message": "Not Found"}
        path = path.removeprefix(BASE)
        if method == "GET" and path in self._questions:
            return 200, self._questions[path]()
        if method != "PUT" or path not in self._orders:
            return 404, {"message": "Not Found"}
        try:
            fields = json.loads(body)
        except ValueError:
            fields = None
        if not isinstance(fields, dict):
            return 400, {"message": "Bad Request"}
        return self._take_order(path, fields)

    def _take_order(self, path: str, fields: Mapping[str, Any]) -> JsonReply:
        if self.refuses_orders:
            return 500, {"message": "Internal Server Error"}
        if not self._c.remote:
            return 403, {"message": "The robot is not in remote control"}
        return self._orders[path](fields)

    def _question_paths(self) -> dict[str, Callable[[], dict[str, Any]]]:
        c = self._c
        paths: dict[str, Callable[[], dict[str, Any]]] = {
            "/openapi.json": self._describe_api,
            "/program/v1/state": lambda: {"state": _STATES.get(c.runtime, "STOPPED")},
        }
        if self._whole:
            paths |= {
                "/program/v1/loaded": lambda: {"name": c.loaded_program},
                "/robotstate/v1/robotmode": lambda: {"mode": c.robot_mode.name},
                "/robotstate/v1/safetymode": lambda: {"mode": self._safety_mode()},
                "/system/v1/controlmode": lambda: {"mode": "REMOTE" if c.remote else "LOCAL"},
                "/system/v1/operationalmode": lambda: {"mode": "AUTOMATIC" if c.automatic else "MANUAL"},
            }
        if c.identity.robot_api_version == _WITH_PLATE:
            paths["/system/v1/information"] = lambda: {
                "serialNumber": c.identity.serial,
                "robotType": c.identity.model_family,
            }
        return paths

    def _describe_api(self) -> dict[str, Any]:
        paths: dict[str, dict[str, Any]] = {}
        for verb, known in (("get", self._questions), ("put", self._orders)):
            for path in known:
                paths.setdefault(path, {})[verb] = {"responses": {"200": {"description": "OK"}}}
        version = self._c.identity.robot_api_version
        return {"openapi": "3.1.0", "info": {"title": "Robot API", "version": version}, "paths": paths}

    def _safety_mode(self) -> str:
        return "EMERGENCY_STOP" if self._c.safety_mode in _EMERGENCY else self._c.safety_mode.name

    def _change_robot_state(self, fields: Mapping[str, Any]) -> JsonReply:
        c, action = self._c, fields.get("action")
        if action in ("POWER_ON", "POWER_OFF"):
            c.switch_power(on=action == "POWER_ON")
        elif action == "BRAKE_RELEASE":
            c.release_brakes()
        elif action == "UNLOCK_PROTECTIVE_STOP":
            if not c.unlock_protective_stop():
                return 409, {"message": "Cannot unlock the protective stop"}
        elif action != "RESTART_SAFETY":
            return 400, {"message": f"Unknown action {action}"}
        return 200, {"state": c.robot_mode.name, "message": f"{action} done"}

    def _change_program_state(self, fields: Mapping[str, Any]) -> JsonReply:
        c, action = self._c, fields.get("action")
        if action == "stop":
            c.end_program()
        elif action == "pause":
            if not c.pause_program():
                return 409, {"message": "No program is playing"}
        elif action in ("play", "resume"):
            if not c.resume_program():
                return 409, {"message": "No program can be started"}
        else:
            return 400, {"message": f"Unknown action {action}"}
        state = _STATES.get(c.runtime, "STOPPED")
        details = f"{str(action).capitalize()} successful"
        return 200, {"state": state, "message": f"Program state changed: {state}", "details": details}

    def _load_program(self, fields: Mapping[str, Any]) -> JsonReply:
        name = fields.get("name" if self._whole else "programName")
        if not isinstance(name, str):
            return 400, {"message": "Bad Request"}
        self._c.loaded_program = name
        return 200, {"state": "STOPPED", "message": f"Program loaded: {name}"}


class RobotApiConnection(PortConnection):
    """One HTTP client."""

    def __init__(self, port: TcpPort, api: RobotApi) -> None:
        super().__init__(port)
        self._api = api
        self._rest = b""

    def on_bytes(self, data: bytes) -> None:
        self._rest += data
        if len(self._rest) > _MOST_BYTES:
            raise ValueError("a request that is too long")
        while (request := self._take_request()) is not None:
            method, path, headers, body = request
            status, reply = self._api.reply_to(method, path.partition("?")[0], body)
            self._send_reply(status, reply)
            if headers.get("connection", "").lower() == "close":
                self.finish()
                return

    def _take_request(self) -> tuple[str, str, dict[str, str], bytes] | None:
        head, found, rest = self._rest.partition(b"\r\n\r\n")
        if not found:
            return None
        first, *lines = head.decode("latin-1").split("\r\n")
        words = first.split(" ")
        if len(words) != 3:
            raise ValueError(f"no request line: {first[:80]!r}")
        headers = {
            name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)
        }
        size = int(headers.get("content-length", "0"))
        if not 0 <= size <= _MOST_BYTES:
            raise ValueError(f"a body of {size} bytes")
        if len(rest) < size:
            return None
        self._rest = rest[size:]
        return words[0], words[1], headers, rest[:size]

    def _send_reply(self, status: int, reply: dict[str, Any]) -> None:
        broken = self._api.broken_answer
        text = (json.dumps(reply) if broken is None else broken).encode()
        lines = [f"HTTP/1.1 {status} {_REASONS[status]}", "Content-Type: application/json"]
        if status == 307:
            lines.append(f"Location: {reply['location']}")
        lines.append(f"Content-Length: {len(text)}")
        self.send("\r\n".join(lines).encode() + b"\r\n\r\n" + text)
