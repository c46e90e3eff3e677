"""What the arm's state means to a technician.

Rests on the safety bits and the program's state. The robot mode only explains why an otherwise healthy arm
cannot move.
"""

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import DeviceError, MotionStoppedError, RefusedError
from cellcal.drivers.interfaces import Condition, Readiness
from cellcal.drivers.universal_robots.rtde import MODE_RUNNING, RuntimeState
from cellcal.drivers.universal_robots.state import StateSample
from cellcal.drivers.wire.tables import CodeEntry, code_table

_PACKAGE = "cellcal.drivers.universal_robots"
_LOWEST_SLIDER = 0.01
_SAFE_BITS, _NONE_SET = 0b11, 64  # normal, reduced; beyond the 32 bits

LOCAL = Condition(
    Readiness.NOT_READY,
    "the pendant is in Local.",
    "Switch the pendant to Remote, or continue by hand.",
)


MANUAL = Condition(
    Readiness.NOT_READY,
    "the operational mode is manual.",
    "Choose the automatic mode at the pendant, or continue by hand.",
)
MODE_UNKNOWN = Condition(
    Readiness.NOT_READY,
    "the controller names an operational mode that is not known here.",
    "Choose the automatic mode at the pendant; report this with the controller's version if it is chosen.",
)
REMOTE_UNKNOWN = Condition(
    Readiness.NOT_READY,
    "the controller does not tell whether the pendant is in Remote.",
    "Update it to PolyScope X 10.12 or later, or continue by hand.",
)


def arm_condition_of(sample: StateSample) -> Condition:
    """Return whether the arm stands under power and is not stopped; who would move it does not matter."""
    entry = _safety_entry(sample) or _mode_entry(sample)
    if entry is None:
        return Condition(Readiness.READY)
    return Condition(
        Readiness(entry.kind), make_message("{entry_text}.", entry_text=entry.text), entry.remedy
    )


def condition_of(sample: StateSample, *, program_is_ours: bool) -> Condition:
    """Return whether the arm could move now, and if not, who must do what."""
    condition = arm_condition_of(sample)
    if condition.readiness is not Readiness.READY:
        return condition
    if sample.runtime_state != RuntimeState.STOPPED and not program_is_ours:
        return Condition(
            Readiness.NOT_READY,
            "a program of another client runs or waits on the robot.",
            "Stop that program at the pendant; starting ours would end it.",
        )
    if sample.speed_fraction < _LOWEST_SLIDER:
        return Condition(
            Readiness.NOT_READY,
            make_message(
                "the speed slider stands at {speed_fraction_percent:.0f} %.",
                speed_fraction_percent=sample.speed_fraction * 100,
            ),
            "Raise the speed slider at the pendant.",
        )
    return condition


def mode_condition_of(mode: str) -> Condition | None:
    """Return what an operational mode forbids; None for automatic, and for "" of a controller that tells none."""
    if mode in ("", "AUTOMATIC"):
        return None
    return MANUAL if mode == "MANUAL" else MODE_UNKNOWN


def safety_stop_of(device: str, sample: StateSample) -> MotionStoppedError | None:
    """Return the safety stop that this state shows, if any."""
    entry = _safety_entry(sample)
    return (
        None
        if entry is None
        else MotionStoppedError(
            device, make_message("{entry_text}.", entry_text=entry.text), remedy=entry.remedy
        )
    )


def condition_error(device: str, condition: Condition) -> DeviceError:
    """Return the error of a command that this condition forbids."""
    kind = MotionStoppedError if condition.readiness is Readiness.STOPPED else RefusedError
    return kind(device, condition.message, remedy=condition.remedy)


def translate_refusal(error: RefusedError) -> RefusedError:
    """Return what ur-rtde said in our words; its own where we have none."""
    for entry in code_table(_PACKAGE, "refusals.tsv").values():
        if entry.kind in error.vendor_text.lower():
            return RefusedError(
                error.device,
                make_message("{entry_text}.", entry_text=entry.text),
                remedy=entry.remedy,
                vendor_code=entry.code,
                vendor_text=error.vendor_text,
            )
    return error


def _safety_entry(sample: StateSample) -> CodeEntry | None:
    table = code_table(_PACKAGE, "safety_bits.tsv")
    bits = sample.safety_status_bits
    known = next((entry for bit, entry in table.items() if bits >> bit & 1), None)
    return known if known is not None or bits & _SAFE_BITS else table[_NONE_SET]


def _mode_entry(sample: StateSample) -> CodeEntry | None:
    if sample.robot_mode == MODE_RUNNING:
        return None
    text = make_message("the arm is in the unknown mode {mode}", mode=sample.robot_mode)
    unknown = CodeEntry(sample.robot_mode, "not_ready", text, "Look at the pendant.")
    return code_table(_PACKAGE, "robot_modes.tsv").get(sample.robot_mode, unknown)
