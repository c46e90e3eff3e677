"""What the controller's alarms and switches mean for a technician."""

import re

from cellcal.drivers.interfaces import Alarm, AlarmKind, Condition, Readiness
from cellcal.drivers.modbus_robot.panel import Block, Panel
from cellcal.drivers.modbus_robot.program import Mode, ProgramState
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


async def read_alarms(panel: Panel) -> Findings:
    """Read the active alarms, newest first, each with what it means."""
    found: list[tuple[Alarm, CodeEntry]] = []
    for number in range(1, panel.profile.registers["alarm_id"].repeats + 1):
        block = await panel.read(*_ALARM_MEMBERS, number=number)
        family, index = block.integer("alarm_id"), block.integer("alarm_number")
        if family == 0:
            break
        code = f"{panel.profile.alarms.get(family, f'ID{family}')}-{index:03d}"
        text = block.text("alarm_text")
        axis = _AXIS.search(text)
        unknown = CodeEntry(index, "unknown", text, "Read the alarm on the pendant and reset it.")
        meaning = code_table("cellcal.drivers.modbus_robot", "alarms.tsv").get(family * 1000 + index, unknown)
        alarm = Alarm(code, text, int(axis[1]) - 1 if axis else None, _BY_KIND[meaning.kind][1])
        found.append((alarm, meaning))
    return tuple(found)


def judge(position: Block, program: ProgramState, alarms: Findings) -> Condition:
    """Say whether the robot can be used, and who must act. A lost position comes before everything else."""
    findings = [(_BY_KIND[entry.kind][0], _sentence(alarm, alarms), entry.remedy) for alarm, entry in alarms]
    findings += _switches(position, program)
    order = (Readiness.POSITION_LOST, Readiness.STOPPED, Readiness.NOT_READY, Readiness.READY)
    findings.sort(key=lambda finding: order.index(finding[0]))
    if not findings:
        return Condition(Readiness.READY)
    remedy = findings[0][2]
    if position.integer("acknowledge") == 1:
        remedy = _POWER_CYCLE
    message = "; ".join(dict.fromkeys(text for _, text, _ in findings))
    return Condition(findings[0][0], message, remedy, tuple(alarm for alarm, _ in alarms))


def _sentence(alarm: Alarm, alarms: Findings) -> str:
    """Say an alarm once, with all the axes that have it."""
    axes = sorted(
        {other.axis + 1 for other, _ in alarms if other.code == alarm.code and other.axis is not None}
    )
    if len(axes) < 2:
        return f"{alarm.code} {alarm.text}"
    return f"{alarm.code} {alarm.text.split(' (')[0]} (axes {', '.join(map(str, axes))})"


def _switches(position: Block, program: ProgramState) -> list[tuple[Readiness, str, str]]:
    found = []
    if position.integer("mastered") != 1:
        found.append((Readiness.POSITION_LOST, "the robot is not mastered", "Run the mastering recovery."))
    if program.emergency:
        remedy = "Look at the cell, release the emergency stop and reset on the pendant."
        found.append((Readiness.STOPPED, "the emergency stop is pressed", remedy))
    if program.mode != Mode.AUTO:
        remedy = "Switch the teach pendant off and the mode switch to AUTO."
        found.append((Readiness.NOT_READY, f"the controller is in {program.mode_name}, not in AUTO", remedy))
    return found
