"""What can happen to a wire, whatever bus its encoder is on.

Imitates
    Technicians and accidents.
Source
    The fault table of the design (F28-F32).
Modelled
    Slack, snap, a slipped hook, outliers; base adaptor and hook moved by hand.
Not modelled
    Anything that ``fake_devices.wire_gauge`` does not.
"""

from collections.abc import Callable
from typing import Any

from cellcal.fake_devices.wire_gauge import WireGauge

Happening = Callable[[dict[str, Any]], None]


def wire_faults(gauge: WireGauge) -> dict[str, Happening]:
    """Return the happenings by name; each takes its parameters out of what it is given."""

    def mount_wire(parameters: dict[str, Any]) -> None:
        point, mouth = int(parameters.pop("point")), parameters.pop("mouth_at_m", None)
        if mouth is None:
            gauge.mount_exit(point)
        else:
            gauge.mount_exit(point, [float(value) for value in mouth])

    return {
        "wire_slack": lambda _parameters: gauge.let_catch(),
        "wire_snap": lambda _parameters: gauge.let_go(),
        "wire_restore": lambda _parameters: gauge.restore_hook(),
        "wire_offset": lambda parameters: gauge.lengthen_readings(float(parameters.pop("m", 0.005))),
        "mount_wire": mount_wire,
        "hook_wire": lambda parameters: gauge.hook_to(int(parameters.pop("target"))),
        "wire_home": lambda _parameters: gauge.go_home(),
        "outlier": lambda parameters: gauge.corrupt_next(
            float(parameters.pop("m", 0.008)), int(parameters.pop("count", 1))
        ),
    }
