"""What the controller's alarms and switches mean for a technician."""

import re

from cellcal.calibration.message import join_messages, make_message
from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness
from cellcal.drivers.modbus_robot.cell_program import ProgramState, SwitchMode
from cellcal.drivers.modbus_robot.register_client import RegisterBlock, RegisterClient
from cellcal.drivers.wire.tables import CodeEntry, code_table

Findings = tuple[tuple[Alarm, CodeEntry], ...]

_AXIS = re.compile(r"Axis:(\d+)")
_ALARM_MEMBERS = ("alarm_id", "alarm_number", "alarm_text")
_POWER_CYCLE = "Switch the controller off and on: the acknowledgement takes effect at power-on."
_BY_KIND = {
    "lost": (Readiness.POSITION_LOST, AlarmKind.TURNS),  # the controller must take note of it (acknowledge)
    "index": (Readiness.POSITION_LOST, AlarmKind.TURNS),  # a motor has to be turned past its index
    "encoder": (Readiness.NOT_READY, AlarmKind.ENCODER),
    "collision": (Readiness.NOT_READY, AlarmKind.COLLISION),
    "battery_low": (Readiness.READY, AlarmKind.BATTERY_LOW),
    "stopped": (Readiness.STOPPED, AlarmKind.OTHER),
    "unknown": (Readiness.NOT_READY, AlarmKind.UNKNOWN),
}


async def read_alarms(panel: RegisterClient) -> Findings:
    """Read the active alarms, newest first, each with what it means."""
    found: list[tuple[Alarm, CodeEntry]] = []
    for number in range(1, panel.profile.registers["alarm_id"].repeats + 1):
        block = await panel.read_registers(*_ALARM_MEMBERS, number=number)
        family, index = block.integer_of("alarm_id"), block.integer_of("alarm_number")
        if family == 0:
            break
        code = f"{panel.profile.alarms.get(family, f'ID{family}')}-{index:03d}"
        text = block.text_of("alarm_text")
        axis = _AXIS.search(text)
        unknown = CodeEntry(index, "unknown", text, "Read the alarm on the pendant and reset it.")
        meaning = code_table("cellcal.drivers.modbus_robot", "alarms.tsv").get(family * 1000 + index, unknown)
        alarm = Alarm(code, text, int(axis[1]) - 1 if axis else None, _BY_KIND[meaning.kind][1])
        found.append((alarm, meaning))
    return tuple(found)


def condition_of(position: RegisterBlock, program: ProgramState, alarms: Findings) -> Condition:
    """Say whether the robot can be used, and who must act. A lost position comes before everything else."""
    findings = [
        (_BY_KIND[entry.kind][0], _alarm_text(alarm, alarms), entry.remedy) for alarm, entry in alarms
    ]
    findings += _switch_conditions(position, program)
    order = (Readiness.POSITION_LOST, Readiness.STOPPED, Readiness.NOT_READY, Readiness.READY)
    findings.sort(key=lambda finding: order.index(finding[0]))
    if not findings:
        return Condition(Readiness.READY)
    remedy = findings[0][2]
    if position.integer_of("acknowledge") == 1:
        remedy = _POWER_CYCLE
    message = join_messages("; ", dict.fromkeys(text for _, text, _ in findings))
    stops = [Condition(*finding) for finding in findings[1:] if finding[0] is Readiness.STOPPED]
    return Condition(
        findings[0][0], message, remedy, tuple(alarm for alarm, _ in alarms), next(iter(stops), None)
    )


def _alarm_text(alarm: Alarm, alarms: Findings) -> str:
    """Say an alarm once, with all the axes that have it."""
    axes = sorted(
        {other.axis + 1 for other, _ in alarms if other.code == alarm.code and other.axis is not None}
    )
    if len(axes) < 2:
        return make_message("{alarm_code} {alarm_text}", alarm_code=alarm.code, alarm_text=alarm.text)
    return make_message(
        "{alarm_code} {alarm_text} (axes {axes})",
        alarm_code=alarm.code,
        alarm_text=alarm.text.split(" (")[0],
        axes=", ".join(map(str, axes)),
    )


def _switch_conditions(position: RegisterBlock, program: ProgramState) -> list[tuple[Readiness, str, str]]:
    found = []
    if position.integer_of("mastered") != 1:
        found.append((Readiness.POSITION_LOST, "the robot is not mastered", "Run the mastering recovery."))
    if program.emergency:
        remedy = "Look at the cell, release the emergency stop and reset on the pendant."
        found.append((Readiness.STOPPED, "the emergency stop is pressed", remedy))
    if program.mode != SwitchMode.AUTO:
        remedy = "Switch the teach pendant off and the mode switch to AUTO."
        found.append(
            (
                Readiness.NOT_READY,
                make_message("the controller is in {mode}, not in AUTO", mode=program.mode_name),
                remedy,
            )
        )
    return found
