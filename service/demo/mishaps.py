"""What can be made to happen to the demo's cell, one button each; the words are the pages'."""

from dataclasses import dataclass, field
from typing import Any

from cellcal.calibration.errors import CellError
from cellcal.service.demo.door import Door

ROBOT, OTHER_ROBOT, WIRE = "fanuc", "ur", "wire"  # as the demo's cell file calls them
_WHILE_S = 10.0  # how long a cable is out


@dataclass(frozen=True, slots=True)
class Mishap:
    """One button. ``kind``: loss, stop, link, person, gauge."""

    name: str
    kind: str
    device: str
    fault: str
    arguments: dict[str, Any] = field(default_factory=dict)


MISHAPS = (
    Mishap("battery", "loss", ROBOT, "battery_loss"),
    Mishap("motor", "loss", ROBOT, "motor_exchange", {"axis": "J3"}),
    Mishap("memory", "loss", ROBOT, "memory_loss"),
    Mishap("references", "loss", ROBOT, "reference_loss"),
    Mishap("crash", "loss", ROBOT, "crash"),
    Mishap("swap", "loss", ROBOT, "swapped_arm"),
    Mishap("backup", "loss", ROBOT, "old_backup"),
    Mishap("battery_low", "loss", ROBOT, "battery_low"),
    Mishap("emergency_stop", "stop", ROBOT, "emergency_stop"),
    Mishap("early_stop", "stop", ROBOT, "early_stop"),
    Mishap("silent", "link", ROBOT, "silent", {"duration_s": _WHILE_S}),
    Mishap("cable", "link", ROBOT, "refuse", {"duration_s": _WHILE_S}),
    Mishap("loose_cable", "link", ROBOT, "flap", {"duration_s": _WHILE_S}),
    Mishap("frozen", "link", ROBOT, "frozen", {"duration_s": _WHILE_S}),
    Mishap("nan", "link", ROBOT, "nan", {"duration_s": _WHILE_S}),
    Mishap("jogged", "person", ROBOT, "jog_by_hand", {"axis": "J1", "rad": 0.05}),
    Mishap("tool", "person", ROBOT, "tool_switched"),
    Mishap("teach_mode", "person", ROBOT, "t1_mode"),
    Mishap("slow", "person", ROBOT, "override", {"percent": 10}),
    Mishap("fast", "person", ROBOT, "override", {"percent": 100}),
    Mishap("outlier", "gauge", WIRE, "outlier", {"m": 0.005, "count": 10}),
    Mishap("slack", "gauge", WIRE, "wire_slack"),
    Mishap("snap", "gauge", WIRE, "wire_snap"),
    Mishap("slipped", "gauge", WIRE, "wire_offset", {"m": 0.005}),
    Mishap("gauge_off", "gauge", WIRE, "node_off"),
    Mishap("gauge_silent", "gauge", WIRE, "sdo_silent", {"duration_s": _WHILE_S}),
    Mishap("gauge_fault", "gauge", WIRE, "emcy"),
    Mishap("ur_protective_stop", "stop", OTHER_ROBOT, "protective_stop"),
    Mishap("ur_emergency_stop", "stop", OTHER_ROBOT, "emergency_stop"),
    Mishap("ur_cable", "link", OTHER_ROBOT, "link_loss_all"),
    Mishap("ur_frozen", "link", OTHER_ROBOT, "frozen"),
    Mishap("ur_tool", "person", OTHER_ROBOT, "tool_switched"),
    Mishap("ur_local", "person", OTHER_ROBOT, "local_mode"),
    Mishap("ur_slow", "person", OTHER_ROBOT, "speed_slider", {"fraction": 0.1}),
    Mishap("ur_fast", "person", OTHER_ROBOT, "speed_slider", {"fraction": 1.0}),
)
_BY_NAME = {mishap.name: mishap for mishap in MISHAPS}

# A lost zero is not among them: that is what cellcal is for.
_MENDED: tuple[tuple[str, str, dict[str, Any]], ...] = (
    (ROBOT, "release_emergency_stop", {}),
    (ROBOT, "auto_mode", {}),
    (ROBOT, "select", {"tool": 1}),
    (ROBOT, "press_reset", {}),
    (ROBOT, "override", {"percent": 100}),
    (WIRE, "wire_restore", {}),
    (WIRE, "node_on", {}),
    (WIRE, "emcy_clear", {}),
    (OTHER_ROBOT, "release_emergency_stop", {}),
    (OTHER_ROBOT, "unlock_protective_stop", {}),
    (OTHER_ROBOT, "link_restore", {}),
    (OTHER_ROBOT, "remote_mode", {}),
    (OTHER_ROBOT, "speed_slider", {"fraction": 1.0}),
    (OTHER_ROBOT, "tool_switched", {"tcp": (0.0,) * 6}),
)


def mishap_named(name: str) -> Mishap:
    """Return a mishap; CellError names those that there are."""
    if name not in _BY_NAME:
        raise CellError(
            f"the demo knows no mishap {name!r}.", remedy=f"Choose {', '.join(_BY_NAME)}.", code="usage"
        )
    return _BY_NAME[name]


async def happen(door: Door, name: str) -> None:
    """Let a mishap happen."""
    mishap = mishap_named(name)
    await door.fault(mishap.fault, device=mishap.device, **mishap.arguments)


async def mend(door: Door) -> None:
    """Put everything back in order that a pair of hands can; what refuses, like an alarm that has a cause, stays."""
    await door.ask("clear")
    for device, fault, arguments in _MENDED:
        try:
            await door.fault(fault, device=device, **arguments)
        except CellError:
            continue
