"""What can be made to happen to the demo's cell, one button each; the words are the pages'."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.demo.fake_cell_client import FakeCellClient

ROBOT, OTHER_ROBOT, WIRE = "fanuc", "ur", "wire"  # as the demo's cell file calls them
_WHILE_S = 10.0  # how long a cable is out


@dataclass(frozen=True, slots=True)
class DemoFault:
    """One button. ``kind``: loss, stop, link, person, gauge."""

    name: str
    kind: str
    device: str
    fault: str
    arguments: Mapping[str, object] = field(default_factory=dict)


DEMO_FAULTS = (
    DemoFault("battery", "loss", ROBOT, "battery_loss"),
    DemoFault("motor", "loss", ROBOT, "motor_exchange", {"axis": "J3"}),
    DemoFault("memory", "loss", ROBOT, "memory_loss"),
    DemoFault("references", "loss", ROBOT, "reference_loss"),
    DemoFault("crash", "loss", ROBOT, "crash"),
    DemoFault("swap", "loss", ROBOT, "swapped_arm"),
    DemoFault("backup", "loss", ROBOT, "old_backup"),
    DemoFault("battery_low", "loss", ROBOT, "battery_low"),
    DemoFault("emergency_stop", "stop", ROBOT, "emergency_stop"),
    DemoFault("early_stop", "stop", ROBOT, "early_stop"),
    DemoFault("silent", "link", ROBOT, "silent", {"duration_s": _WHILE_S}),
    DemoFault("cable", "link", ROBOT, "refuse", {"duration_s": _WHILE_S}),
    DemoFault("loose_cable", "link", ROBOT, "flap", {"duration_s": _WHILE_S}),
    DemoFault("frozen", "link", ROBOT, "frozen", {"duration_s": _WHILE_S}),
    DemoFault("nan", "link", ROBOT, "nan", {"duration_s": _WHILE_S}),
    DemoFault("jogged", "person", ROBOT, "jog_by_hand", {"axis": "J1", "rad": 0.05}),
    DemoFault("tool", "person", ROBOT, "tool_switched"),
    DemoFault("teach_mode", "person", ROBOT, "t1_mode"),
    DemoFault("slow", "person", ROBOT, "override", {"percent": 10}),
    DemoFault("fast", "person", ROBOT, "override", {"percent": 100}),
    DemoFault("outlier", "gauge", WIRE, "outlier", {"m": 0.005, "count": 10}),
    DemoFault("slack", "gauge", WIRE, "wire_slack"),
    DemoFault("snap", "gauge", WIRE, "wire_snap"),
    DemoFault("slipped", "gauge", WIRE, "wire_offset", {"m": 0.005}),
    DemoFault("gauge_off", "gauge", WIRE, "node_off"),
    DemoFault("gauge_silent", "gauge", WIRE, "sdo_silent", {"duration_s": _WHILE_S}),
    DemoFault("gauge_fault", "gauge", WIRE, "emcy"),
    DemoFault("ur_protective_stop", "stop", OTHER_ROBOT, "protective_stop"),
    DemoFault("ur_emergency_stop", "stop", OTHER_ROBOT, "emergency_stop"),
    DemoFault("ur_cable", "link", OTHER_ROBOT, "link_loss_all"),
    DemoFault("ur_frozen", "link", OTHER_ROBOT, "frozen"),
    DemoFault("ur_tool", "person", OTHER_ROBOT, "tool_switched"),
    DemoFault("ur_local", "person", OTHER_ROBOT, "local_mode"),
    DemoFault("ur_slow", "person", OTHER_ROBOT, "speed_slider", {"fraction": 0.1}),
    DemoFault("ur_fast", "person", OTHER_ROBOT, "speed_slider", {"fraction": 1.0}),
)
_BY_NAME = {fault.name: fault for fault in DEMO_FAULTS}

# A lost zero is not among them: that is what cellcal is for.
_CLEARING_FAULTS: tuple[tuple[str, str, Mapping[str, object]], ...] = (
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


def fault_named(name: str) -> DemoFault:
    """Return a fault; CellError names those that there are."""
    if name not in _BY_NAME:
        raise CellError(
            make_message("the demo has no fault {name!r}.", name=name),
            remedy=make_message("Choose {by_name}.", by_name=", ".join(_BY_NAME)),
            code="usage",
        )
    return _BY_NAME[name]


async def trigger_fault(fake_cell: FakeCellClient, name: str) -> None:
    """Let a fault happen."""
    fault = fault_named(name)
    await fake_cell.inject_fault(fault.fault, device=fault.device, **fault.arguments)


async def clear_faults(fake_cell: FakeCellClient) -> None:
    """Put everything back in order that a pair of hands can; what refuses, like an alarm that has a cause, stays."""
    await fake_cell.send_command("clear")
    for device, fault, arguments in _CLEARING_FAULTS:
        try:
            await fake_cell.inject_fault(fault, device=device, **arguments)
        except CellError:
            continue
