"""What the web service answers to each path.

Imitates
    Robot Web Services 1 with json=1.
Source
    ABB 3HAC050973-001 rev M; the fields that abb-robot-client 0.4.0 reads; MOTOR_CALIB as a public program reads it.
Modelled
    The paths in the table; symbols are read and set.
Not modelled
    XML, subscriptions, signals, mastership: 404.
"""

from collections.abc import Callable, Mapping
from typing import Any

from cellcal.fake_devices.abb_web_services.controller import AbbController
from cellcal.fake_devices.abb_web_services.files import FOLDER
from cellcal.fake_devices.abb_web_services.http_port import HttpRequest
from cellcal.fake_devices.abb_web_services.program import NO_AXIS
from cellcal.fake_devices.abb_web_services.quaternions import quaternion_of

Reply = tuple[int, Any]
_UNIT = "/rw/motionsystem/mechunits/ROB_1"
_SECOND_UNIT = "/rw/motionsystem/mechunits/ROB_2"
_MOTOR_CALIBRATION = "/rw/cfg/MOC/MOTOR_CALIB/instances/"
_SYMBOL = "/rw/rapid/symbol/data/RAPID/T_ROB1/"
_FAR = "8.9999998E+09"


class ResourceTable:
    """Answers of one controller."""

    def __init__(self, controller: AbbController) -> None:
        self._c = controller
        c = controller
        self._states: dict[str, Callable[[], dict[str, Any]]] = {
            "/rw/panel/opmode": lambda: {"_type": "pnl-opmode", "opmode": c.mode},
            "/rw/panel/ctrlstate": lambda: {"_type": "pnl-ctrlstate", "ctrlstate": c.motors},
            "/rw/panel/speedratio": lambda: {"_type": "pnl-speedratio", "speedratio": str(c.speed_percent)},
            "/rw/rapid/execution": self._execution_state,
            "/rw/rapid/tasks": self._task_state,
            "/rw/system": lambda: {"_type": "sys-system-li", "name": "cell", "rwversion": "6.15.04.00"},
            "/ctrl/identity": lambda: {
                "_type": "ctrl-identity-info",
                "ctrl-name": "cell",
                "ctrl-id": c.serial,
                "ctrl-type": c.title,
            },
            _UNIT: lambda: {
                "_type": "ms-mechunit",
                "tool-name": c.tool_name,
                "wobj-name": c.work_object,
                "mode": "Activated",
                "status": c.unit_status,
            },
            _SECOND_UNIT: lambda: {"_type": "ms-mechunit", "_title": "ROB_2", "mode": "Activated"},
            f"{_UNIT}/jointtarget": self._joint_target,
            f"{_UNIT}/robtarget": self._robot_target,
        }

    def answer(self, request: HttpRequest) -> Reply:
        """Return status and content of an answer."""
        method, path, query, form = request.method, request.path, request.query, request.form
        if path.startswith(FOLDER):
            return self._answer_file_request(request, path.removeprefix(FOLDER).strip("/"))
        if path.startswith(_SYMBOL):
            return self._answer_symbol_request(method, path.removeprefix(_SYMBOL), query, form)
        return (
            self._read_resource(path, query)
            if method == "GET"
            else self._perform_action(path, query.get("action", ""), form)
        )

    def _answer_file_request(self, request: HttpRequest, name: str) -> Reply:
        files = self._c.files
        if request.method == "GET" and not name:
            entries, following = files.list_page(int(request.query.get("start", "1")))
            links = {} if following is None else {"next": {"href": f"?json=1&start={following}"}}
            return 200, {"_links": links, "_embedded": {"_state": entries}}
        if request.method == "GET":
            content = files.contents.get(name)
            return (200, content) if content is not None else _refuse_request(404, "no such file")
        if request.method != "POST":
            status = files.change_file(request.method, name, request.body)
        else:
            form = request.form
            status = files.copy_file(name, form) if form.get("fs-action") == "copy" else 400
        return (status, None) if status < 400 else _refuse_request(status, "the file service refuses")

    def _read_resource(self, path: str, query: Mapping[str, str]) -> Reply:
        if path in ("/logout", "/"):
            return 200, {}
        if path.rstrip("/") == "/rw/elog/0":
            return 200, {"_embedded": {"_state": self._log_entries(query)}}
        if path.startswith(f"{_UNIT}/axes/"):
            return self._axis_state(path.rpartition("/")[2])
        if path.startswith(_MOTOR_CALIBRATION):
            return self._motor_calibration(path.removeprefix(_MOTOR_CALIBRATION))
        if path in self._states and (path != _SECOND_UNIT or self._c.has_second_robot):
            return 200, {"_embedded": {"_state": [self._states[path]()]}}
        return _refuse_request(404, "no such resource")

    def _perform_action(self, path: str, action: str, form: Mapping[str, str]) -> Reply:
        if path == "/rw/panel/speedratio" and action == "setspeedratio":
            return self._set_speed(form)
        return (
            self._control_execution(action)
            if path == "/rw/rapid/execution"
            else _refuse_request(404, "no such resource")
        )

    def _answer_symbol_request(
        self, method: str, name: str, query: Mapping[str, str], form: Mapping[str, str]
    ) -> Reply:
        if method == "POST":
            written = query.get("action") == "set" and self._c.write_symbol(name, form.get("value", ""))
            return (
                (204, None)
                if written
                else _refuse_request(400, "the symbol is not there, or the value does not fit")
            )
        value = self._c.read_symbol(name)
        if value is None:
            return _refuse_request(400, "no such symbol")
        return 200, {"_embedded": {"_state": [{"_type": "rap-data", "value": value}]}}

    def _axis_state(self, number: str) -> Reply:
        if not number.isdigit() or not 1 <= int(number) <= 6:
            return _refuse_request(404, "no such axis")
        state = {"_type": "ms-axis", "axis-status": self._c.axis_states[int(number) - 1]}
        return 200, {"_embedded": {"_state": [state]}}

    def _motor_calibration(self, name: str) -> Reply:
        if name not in (names := [f"rob1_{axis}" for axis in range(1, 7)]):
            return _refuse_request(400, "no such instance")
        offset = self._c.calibration_offsets[names.index(name)]
        values = {"name": name, "valid_com_offset": "true", "com_offset": "1.5708"}
        values |= {"cal_offset": f"{offset:g}", "valid_cal_offset": "true"}
        rows = [{"_type": "cfg-ia-t-li", "_title": key, "value": value} for key, value in values.items()]
        state = {"_type": "cfg-dt-instance-li", "_title": name, "attrib": rows}
        return 200, {"_embedded": {"_state": [state]}}

    def _set_speed(self, form: Mapping[str, str]) -> Reply:
        try:
            self._c.set_speed(int(form.get("speed-ratio", "")))
        except ValueError:
            return _refuse_request(400, "1 to 100")
        return 204, None

    def _control_execution(self, action: str) -> Reply:
        if action == "start":
            self._c.server.task.press_start()
        elif action == "stop":
            self._c.server.task.stop_program()
        elif action != "resetpp":
            return _refuse_request(400, "no such action")
        elif not self._c.program_runs:
            self._c.server.task.move_pointer_to_main()
        return 204, None

    def _execution_state(self) -> dict[str, Any]:
        state = "running" if self._c.program_runs else "stopped"
        return {"_type": "rap-execution", "ctrlexecstate": state, "cycle": "forever"}

    def _task_state(self) -> dict[str, Any]:
        state = "start" if self._c.program_runs else "stop"
        return {
            "_type": "rap-task-li",
            "name": "T_ROB1",
            "type": "norm",
            "taskstate": "link",
            "excstate": state,
            "active": "On",
            "motiontask": "TRUE",
        }

    def _joint_target(self) -> dict[str, Any]:
        state: dict[str, Any] = {"_type": "ms-jointtarget"}
        state |= {f"rax_{axis}": f"{value:.9g}" for axis, value in enumerate(self._c.joints_deg(), 1)}
        return state | {
            f"eax_{axis}": _FAR if value >= NO_AXIS * 0.9 else f"{value:.9g}"
            for axis, value in zip("abcdef", self._c.external, strict=True)
        }

    def _robot_target(self) -> dict[str, Any]:
        pose = self._c.flange_pose()
        state: dict[str, Any] = {"_type": "ms-robtargets"}
        state |= {key: f"{float(value) * 1e3:.9g}" for key, value in zip("xyz", pose[:3, 3], strict=True)}
        state |= {f"q{k}": f"{value:.10g}" for k, value in enumerate(quaternion_of(pose[:3, :3]), 1)}
        state |= dict.fromkeys(("cf1", "cf4", "cf6", "cfx"), "0")
        return state | {f"eax{axis}": _FAR for axis in "abcdef"}

    def _log_entries(self, query: Mapping[str, str]) -> list[dict[str, Any]]:
        texts = dict.fromkeys(("desc", "conseqs", "causes", "actions"), "")
        return [
            {
                "_type": "elog-message-li",
                "_title": f"/rw/elog/0/{number}",
                "msgtype": str(kind),
                "code": str(code),
                "tstamp": stamp,
                "title": title,
                "argc": "0",
                **texts,
            }
            for number, (code, kind, stamp, title) in self._c.log_page(query)
        ]


def _refuse_request(status: int, text: str) -> Reply:
    return status, {"_embedded": {"status": {"code": "-1073445859", "msg": text}}}
