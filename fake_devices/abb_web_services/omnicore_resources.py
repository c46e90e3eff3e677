"""What the web service of an OmniCore answers to each path.

Imitates
    Robot Web Services 2.
Source
    ABB OmniCore App SDK 1.5.0: /rw/mastership/edit, /rw/rapid, /rw/panel, /ctrl, /rw/elog, /fileservice. Paths that
    public clients cite from ABB 3HAC073675-001: /rw/motionsystem. Answers of a virtual controller with RobotWare 7.21
    as a public client's tests keep them: jointtarget, mechunit, axis.
Modelled
    The paths in the tables; RAPID data with mastership; mastership of one session at a time, lost with the session
    and with the mode; execution and its stop.
Not modelled
    RMMP (so mastership is refused in manual mode), signals, configuration, backup, jogging, control stations of
    RobotWare 8: 404.
"""

from collections.abc import Callable, Mapping
from typing import Any

from cellcal.fake_devices.abb_web_services.controller import AbbController
from cellcal.fake_devices.abb_web_services.files import FOLDER
from cellcal.fake_devices.abb_web_services.http_port import HttpRequest
from cellcal.fake_devices.abb_web_services.program import NO_AXIS
from cellcal.fake_devices.abb_web_services.quaternions import quaternion_of

Reply = tuple[int, Any]
Table = dict[str, Any]
_UNIT = "/rw/motionsystem/mechunits/ROB_1"
_SYMBOL, _DATA = "/rw/rapid/symbol/RAPID/T_ROB1/", "/data"
_ABSENT = "9E+09"
_EDIT, _MOTION = "edit", "motion"


class OmnicoreResources:
    """Answers of one controller."""

    def __init__(self, controller: AbbController) -> None:
        self._c = controller
        self._masters: dict[str, str] = {}  # session by domain
        self._reads: dict[str, Callable[[], list[Table]]] = {
            "/ctrl/identity": self._identity_state,
            "/rw/system": lambda: [_state_table("sys-system", "system", name="cell", rwversion="7.21.0+150")],
            "/rw/panel/opmode": lambda: [_state_table("pnl-opmode", "opmode", opmode=controller.mode)],
            "/rw/panel/ctrl-state": lambda: [
                _state_table("pnl-ctrlstate", "ctrl-state", ctrlstate=controller.motors)
            ],
            "/rw/panel/speedratio": lambda: [
                _state_table("pnl-speedratio", "speedratio", speedratio=str(controller.speed_percent))
            ],
            "/rw/rapid/execution": self._execution_state,
            "/rw/rapid/tasks/T_ROB1/modules": lambda: [
                _state_table("rap-module-info-li", "CellcalServer", name="CellcalServer", type="ProgMod"),
                _state_table("rap-module-info-li", "BASE", name="BASE", type="SysMod"),
            ],
            _UNIT: self._unit_state,
            f"{_UNIT}/jointtarget": self._joint_target,
            f"{_UNIT}/robtarget": self._robot_target,
        }
        self._lists: dict[str, Callable[[], list[Table]]] = {
            "/rw/motionsystem/mechunits": lambda: [_state_table("ms-mechunit-li", "ROB_1", mode="Activated")],
        }

    def answer(self, request: HttpRequest, session: str) -> Reply:
        """Return status and content of an answer."""
        path = request.path.rstrip("/") or "/"
        if self._c.mode != "AUTO":
            self._masters.clear()
        if path.startswith(_SYMBOL) and path.endswith(_DATA):
            name = path.removeprefix(_SYMBOL).removesuffix(_DATA)
            return self._answer_symbol_request(request.method, name, request.form, session)
        if path.startswith(FOLDER):
            return self._answer_file_request(request, path.removeprefix(FOLDER).strip("/"))
        if request.method == "POST":
            return self._perform_action(path, request.form, session)
        return self._read_resource(path, request.query)

    def end_session(self, session: str) -> None:
        """Take back what a session had."""
        self._masters = {domain: one for domain, one in self._masters.items() if one != session}

    def _answer_file_request(self, request: HttpRequest, name: str) -> Reply:
        files = self._c.files
        if request.method == "GET" and not name:
            entries, following = files.list_page(int(request.query.get("start", "1")))
            links = (
                _base_links()
                if following is None
                else {**_base_links(), "next": {"href": f"$HOME?start={following}"}}
            )
            return 200, {"_links": links, "_embedded": {"resources": entries}}
        if request.method == "GET":
            content = files.contents.get(name)
            return (
                (200, content) if content is not None else _refuse_request(404, -1073445859, "no such file")
            )
        if request.method == "POST" and name.endswith("/copy"):
            status = files.copy_file(name.removesuffix("/copy"), request.form)
        else:
            status = files.change_file(request.method, name, request.body)
        return (
            (status, None)
            if status < 400
            else _refuse_request(status, -1073445859, "the file service refuses")
        )

    def _read_resource(self, path: str, query: Mapping[str, str]) -> Reply:
        if path in ("/", "/rw"):
            return 200, _state_document([])
        if path in self._reads:
            return 200, _state_document(self._reads[path]())
        if path == "/rw/elog/0":
            return 200, {"_links": _base_links(), "_embedded": {"resources": self._log_entries(query)}}
        if path in self._lists:
            return 200, {"_links": _base_links(), "_embedded": {"resources": self._lists[path]()}}
        if path.startswith(f"{_UNIT}/axes/"):
            return self._axis_state(path.rpartition("/")[2])
        return _refuse_request(404, -1073445859, "no such resource")

    def _perform_action(self, path: str, form: Mapping[str, str], session: str) -> Reply:
        if path.startswith("/rw/mastership/"):
            return self._change_mastership(path.removeprefix("/rw/mastership/").split("/"), session)
        if path == "/rw/panel/speedratio":
            return self._set_speed(form)
        if path.startswith("/rw/rapid/execution/"):
            return self._control_execution(path.rpartition("/")[2], session)
        return _refuse_request(404, -1073445859, "no such resource")

    def _change_mastership(self, words: list[str], session: str) -> Reply:
        domains, action = (words[:-1], words[-1])
        if action not in ("request", "release") or not set(domains) <= {_EDIT, _MOTION}:
            return _refuse_request(404, -1073445859, "no such resource")
        domains = domains or [_EDIT, _MOTION]
        if action == "release":
            if any(self._masters.get(domain) != session for domain in domains):
                return _refuse_request(403, -1073445871, "mastership is not held")
            for domain in domains:
                del self._masters[domain]
            return 204, None
        if self._c.mode != "AUTO":
            return _refuse_request(403, -1073445865, "the operator has to grant access")
        if any(self._masters.get(domain, session) != session for domain in domains):
            return _refuse_request(403, -1073445870, "mastership is held by another client")
        self._masters |= dict.fromkeys(domains, session)
        return 204, None

    def _answer_symbol_request(self, method: str, name: str, form: Mapping[str, str], session: str) -> Reply:
        if method == "POST":
            if self._masters.get(_EDIT) != session:
                return _refuse_request(403, -1073414146, "mastership is missing")
            if not self._c.write_symbol(name, form.get("value", "")):
                return _refuse_request(400, -1073414145, "the symbol is not there, or the value does not fit")
            return 204, None
        value = self._c.read_symbol(name)
        if value is None:
            return _refuse_request(400, -1073414145, "no such symbol")
        return 200, _state_document([_state_table("rap-data", f"RAPID/T_ROB1/{name}", value=value)])

    def _axis_state(self, number: str) -> Reply:
        if not number.isdigit() or not 1 <= int(number) <= 6:
            return _refuse_request(404, -1073445859, "no such axis")
        state = self._c.axis_states[int(number) - 1]
        return 200, _state_document(
            [
                _state_table("ms-mechunit-axisstatus", "axisstatus", **{"axis-status": state}),
                _state_table("ms-mechunit-logicalaxis", "logicalaxis", **{"logical-axis": number}),
            ]
        )

    def _set_speed(self, form: Mapping[str, str]) -> Reply:
        try:
            self._c.set_speed(int(form.get("speed-ratio", "")))
        except ValueError:
            return _refuse_request(400, -1073445859, "1 to 100")
        return 204, None

    def _control_execution(self, action: str, session: str) -> Reply:
        if action == "start":
            if _EDIT in self._masters:
                return _refuse_request(403, -1073445870, "mastership is held")
            self._c.server.task.press_start()
        elif action == "stop":
            self._c.server.task.stop_program()
        elif action == "resetpp":
            if self._masters.get(_EDIT) != session:
                return _refuse_request(403, -1073414146, "mastership is missing")
            self._reset_pointer()
        else:
            return _refuse_request(404, -1073445859, "no such action")
        return 204, None

    def _identity_state(self) -> list[Table]:
        names = {"ctrl-name": "cell", "ctrl-id": self._c.serial, "ctrl-type": self._c.title}
        return [_state_table("ctrl-identity-info", "identity", **names, **{"ctrl-mac": "00:00:5e:00:53:01"})]

    def _reset_pointer(self) -> None:
        if not self._c.program_runs:
            self._c.server.task.move_pointer_to_main()

    def _execution_state(self) -> list[Table]:
        state = "running" if self._c.program_runs else "stopped"
        return [_state_table("rap-execution", "execution", ctrlexecstate=state, cycle="forever")]

    def _unit_state(self) -> list[Table]:
        names = {"tool-name": self._c.tool_name, "wobj-name": self._c.work_object, "task-name": "T_ROB1"}
        counts = {"axes": "6", "axes-total": "6", "coord-system": "World", "jog-mode": "AxisGroup1"}
        state = {"mode": "Activated", "status": self._c.unit_status, "type": "TCPRobot"}
        return [_state_table("ms-mechunit", "ROB_1", **state, **counts, **names)]

    def _joint_target(self) -> list[Table]:
        joints = {f"rax_{axis}": f"{value:.9g}" for axis, value in enumerate(self._c.joints_deg(), 1)}
        return [_state_table("ms-jointtarget", "ROB_1", **joints, **self._external_axes())]

    def _external_axes(self) -> dict[str, str]:
        return {
            f"eax_{axis}": _external_text(value)
            for axis, value in zip("abcdef", self._c.external, strict=True)
        }

    def _robot_target(self) -> list[Table]:
        pose = self._c.flange_pose()
        place = {key: f"{float(value) * 1e3:.9g}" for key, value in zip("xyz", pose[:3, 3], strict=True)}
        turn = {f"q{k}": f"{value:.10g}" for k, value in enumerate(quaternion_of(pose[:3, :3]), 1)}
        return [_state_table("ms-robtargets", "ROB_1", **place, **turn, cf1="0", cf4="0", cf6="0", cfx="0")]

    def _log_entries(self, query: Mapping[str, str]) -> list[Table]:
        return [
            {
                **_state_table("elog-message-li", f"/rw/elog/0/{number}", msgtype=str(kind), code=str(code)),
                "_links": {"self": {"href": f"0/{number}?lang=en"}},
                "src-name": "MC0",
                "tstamp": stamp,
                "title": title,
                "argc": "0",
                **dict.fromkeys(("desc", "conseqs", "causes", "actions"), ""),
            }
            for number, (code, kind, stamp, title) in self._c.log_page(query)
        ]


def _base_links() -> Table:
    return {"base": {"href": "https://omnicore/"}, "self": {"href": ""}}


def _state_document(states: list[Table]) -> Table:
    return {"_links": _base_links(), "status": {"code": 294912}, "state": states}


def _state_table(kind: str, title: str, **values: str) -> Table:
    return {"_type": kind, "_title": title, **values}


def _refuse_request(status: int, code: int, text: str) -> Reply:
    return status, {"status": {"code": code, "msg": text}}


def _external_text(value: float) -> str:
    return _ABSENT if value >= NO_AXIS * 0.9 else f"{value:.9g}"
