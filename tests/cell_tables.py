"""Tables of cell files for tests: one function for each kind of device, with its usual values and a test's own.

``{address}`` and ``{folder}`` stand for what only a running test knows; `fill_in` puts it there.
"""

import json
from typing import Any

_LISTED = {"robot", "gauge", "tracker", "probe", "robot.space.plane", "fake.artefact"}
FLOOR = {"name": "floor", "point_in_base_mm": [0, 0, -900], "normal_in_base": [0, 0, 1]}


def fill_in(text: str, **values: str) -> str:
    """Return a text with what stands for ``{name}`` in it."""
    for name, value in values.items():
        text = text.replace(f"{{{name}}}", value)
    return text


def write_table(kind: str, /, **fields: Any) -> str:
    """Return one table as TOML; a field that is None is left out."""
    head = f"[[{kind}]]" if kind in _LISTED else f"[{kind}]"
    lines = [f"{key} = {_write_value(value)}" for key, value in fields.items() if value is not None]
    return "\n".join((head, *lines, "\n"))


def _write_value(value: Any) -> str:
    if isinstance(value, dict):
        inside = ", ".join(f"{key} = {_write_value(each)}" for key, each in value.items())
        return f"{{ {inside} }}"
    return json.dumps(value, ensure_ascii=False)


def cell_head(name: str, data_dir: str = "{folder}") -> str:
    """Return the first table of a cell file."""
    return write_table("cell", name=name, data_dir=data_dir)


def robot_table(**fields: Any) -> str:
    """Return a robot that moves on command at half a radian per second, and the floor below it."""
    usual = {"address": "{address}", "motion": "commanded", "speed_limit_rad_s": 0.5}
    return write_table("robot", **usual | fields) + write_table("robot.space.plane", **FLOOR)


def fanuc_table(**changes: Any) -> str:
    """Return the FANUC M-6iB behind Modbus."""
    usual = {
        "name": "fanuc",
        "driver": "modbus_robot",
        "profile": "fanuc_hmi",
        "port": 1502,
        "model": "fanuc_m6ib",
        "serial": "F-104711",
        "deadline_s": 6.0,
        "settle_s": 0.01,
    }
    return robot_table(**usual | changes)


def universal_robots_table(**changes: Any) -> str:
    """Return the UR10e."""
    usual = {
        "name": "ur",
        "driver": "universal_robots",
        "model": "ur10e",
        "serial": "20225500042",
        "watchdog_hz": 1.0,  # a test machine may be too busy for 5
    }
    return robot_table(**usual | changes)


def draw_wire_table(**changes: Any) -> str:
    """Return the draw-wire behind socketcand, between the FANUC's flange and the floor."""
    usual = {
        "name": "wire",
        "driver": "draw_wire",
        "interface": "socketcand",
        "host": "{address}",
        "port": 29536,
        "channel": "can0",
        "node_id": 7,
        "serial": 4711,
        "range_m": 3.0,
        "sigma_m": 0.0002,
        "deadline_s": None,
        "heartbeat_s": None,
        "robot": "fanuc",  # what follows is where it hangs: also a wire without a link has that
        "anchor_in_base_mm": [900.0, -700.0, -450.0],
        "hook_in_flange_mm": [60.0, 50.0, 120.0],
    }
    return write_table("gauge", **usual | changes)


def tracker_table(**changes: Any) -> str:
    """Return the laser tracker that sees a reflector on the FANUC's flange."""
    usual = {
        "name": "tracker",
        "driver": "laser_tracker",
        "address": "{address}",
        "port": 7700,
        "serial": 390793,
        "station": 2,
        "robot": "fanuc",
        "deadline_s": 10.0,
        "target_in_flange_mm": [80.0, 40.0, 100.0],
    }
    return write_table("tracker", **usual | changes)


def touch_probe_table(**changes: Any) -> str:
    """Return the touch probe at an input of the coupler."""
    usual = {
        "name": "probe",
        "driver": "touch_probe",
        "contact_input": 1,
        "tip_radius_mm": 1.5,
        "sigma_mm": 0.003,
        "delay_ms": 6.0,
        "delay_tolerance_ms": 3.0,
    }
    return _write_coupler_table(usual | changes)


def dial_gauge_table(**changes: Any) -> str:
    """Return the dial gauge at another input of the coupler."""
    usual = {
        "name": "dial",
        "driver": "dial_gauge",
        "dial_input": 2,
        "tip_in_flange_mm": [0.0, 0.0, 160.0],
        "range_mm": 12.5,
        "sigma_mm": 0.01,
    }
    return _write_coupler_table(usual | changes)


def _write_coupler_table(fields: dict[str, Any]) -> str:
    coupler = {
        "address": "{address}",
        "port": 1503,
        "serial": "00:30:DE:0A:0B:0C",
        "robot": "fanuc",
        "deadline_s": 5.0,
    }
    return write_table("probe", **coupler | fields)


def fake_table(**changes: Any) -> str:
    """Return what only the simulator reads."""
    return write_table("fake", **{"seed": 1, "control_port": 0} | changes)
