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


def wire_happenings(gauge: WireGauge) -> dict[str, Happening]:
    """Return the happenings by name; each takes its parameters out of what it is given."""

    def mount(given: dict[str, Any]) -> None:
        point, mouth = int(given.pop("point")), given.pop("mouth_at_m", None)
        if mouth is None:
            gauge.mount(point)
        else:
            gauge.mount(point, [float(value) for value in mouth])

    return {
        "wire_slack": lambda _given: gauge.slacken(),
        "wire_snap": lambda _given: gauge.snap(),
        "wire_restore": lambda _given: gauge.restore(),
        "wire_offset": lambda given: gauge.slip(float(given.pop("m", 0.005))),
        "mount_wire": mount,
        "hook_wire": lambda given: gauge.hook_to(int(given.pop("target"))),
        "wire_home": lambda _given: gauge.go_home(),
        "outlier": lambda given: gauge.spoil_next(float(given.pop("m", 0.008)), int(given.pop("count", 1))),
    }
