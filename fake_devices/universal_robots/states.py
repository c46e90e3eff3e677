"""Numbers and bits with which the controller tells how it is.

Imitates
    Robot modes, safety modes, runtime states and their bit words.
Source
    The maker's RTDE guide: robot modes, safety modes, runtime states, status bits.
Modelled
    Normal, protective stop, emergency stop; power off, idle, running; program stopped, playing, paused.
Not modelled
    Reduced mode, safeguard stops, recovery mode, backdrive: their numbers exist, nothing leads there.
"""

from enum import IntEnum


class RobotMode(IntEnum):
    """robot_mode."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(IntEnum):
    """safety_mode."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class RuntimeState(IntEnum):
    """runtime_state."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


_STOPPED_DUE_TO_SAFETY = 1 << 10
_EMERGENCY = 1 << 7
_SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.REDUCED: 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | _STOPPED_DUE_TO_SAFETY,
    SafetyMode.RECOVERY: 1 << 3,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | _STOPPED_DUE_TO_SAFETY,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | _EMERGENCY | _STOPPED_DUE_TO_SAFETY,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | _EMERGENCY | _STOPPED_DUE_TO_SAFETY,
    SafetyMode.VIOLATION: 1 << 8 | _STOPPED_DUE_TO_SAFETY,
    SafetyMode.FAULT: 1 << 9 | _STOPPED_DUE_TO_SAFETY,
}


def safety_bits(mode: SafetyMode) -> int:
    """Return safety_status_bits."""
    return _SAFETY_BITS[mode]


def status_bits(mode: RobotMode, runtime: RuntimeState, *, power_button: bool = False) -> int:
    """Return robot_status_bits."""
    powered = mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.BACKDRIVE, RobotMode.RUNNING)
    return int(powered) | int(runtime is RuntimeState.PLAYING) << 1 | int(power_button) << 3


def joint_mode(mode: RobotMode) -> int:
    """Return what each of the six joints says."""
    return {RobotMode.RUNNING: 253, RobotMode.IDLE: 255, RobotMode.BACKDRIVE: 238}.get(mode, 239)
