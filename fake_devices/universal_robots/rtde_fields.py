"""Names and types of everything RTDE can carry.

Imitates
    The variable lists of the controller's real-time data exchange.
Source
    The maker's RTDE guide, lists of robot controller outputs and inputs.
Modelled
    Every variable of those lists, with the software version that brought it where that is known.
Not modelled
    Variables of options that need other hardware (tool modbus, EtherNet/IP).
"""

from struct import Struct

BOOL, UINT8, UINT32, UINT64, INT32 = "BOOL", "UINT8", "UINT32", "UINT64", "INT32"
DOUBLE, VECTOR3D, VECTOR6D, VECTOR6INT32 = "DOUBLE", "VECTOR3D", "VECTOR6D", "VECTOR6INT32"

_CODES = {
    BOOL: "?",
    UINT8: "B",
    UINT32: "I",
    UINT64: "Q",
    INT32: "i",
    DOUBLE: "d",
    VECTOR3D: "3d",
    VECTOR6D: "6d",
    VECTOR6INT32: "6i",
    "VECTOR6UINT32": "6I",
}

_INPUTS: dict[str, str] = {
    UINT32: "speed_slider_mask input_bit_registers0_to_31 input_bit_registers32_to_63",
    DOUBLE: "speed_slider_fraction standard_analog_output_0 standard_analog_output_1",
    UINT8: (
        "standard_digital_output_mask configurable_digital_output_mask tool_digital_output_mask"
        " standard_digital_output configurable_digital_output tool_digital_output"
        " standard_analog_output_mask standard_analog_output_type"
    ),
    VECTOR6D: "external_force_torque",
}

_OUTPUTS: dict[str, str] = {
    DOUBLE: (
        "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum"
        " actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0"
        " standard_analog_input1 standard_analog_output0 standard_analog_output1 payload"
        " target_execution_time io_current actual_robot_energy_consumed"
        " actual_robot_braking_energy_dissipated euromap67_24V_voltage euromap67_24V_current"
        " tool_analog_input0 tool_analog_input1 tool_output_current tool_temperature tcp_force_scalar"
        " joint_position_deviation_ratio collision_detection_ratio"
    ),
    VECTOR6D: (
        "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_qdd"
        " actual_current actual_moment joint_control_output actual_TCP_pose actual_TCP_speed"
        " actual_TCP_force target_TCP_pose target_TCP_speed joint_temperatures actual_joint_voltage"
        " ft_raw_wrench payload_inertia actual_current_as_torque actual_current_window tcp_offset"
        " actual_TCP_acceleration target_TCP_acceleration wrench_calc_from_currents"
        " target_base_acceleration target_base_wrench"
    ),
    VECTOR3D: "actual_tool_accelerometer payload_cog elbow_position elbow_velocity target_gravity",
    INT32: (
        "robot_mode safety_mode safety_status encoder0_raw encoder1_raw tool_output_voltage time_scale_source"
    ),
    VECTOR6INT32: "joint_mode",
    UINT32: (
        "runtime_state robot_status_bits safety_status_bits analog_io_types euromap67_input_bits"
        " euromap67_output_bits tool_mode tool_analog_input_types script_control_line"
        " output_bit_registers0_to_31 output_bit_registers32_to_63"
    ),
    UINT64: (
        "actual_digital_input_bits actual_digital_output_bits control_step"
        " actual_configurable_digital_input_bits actual_configurable_digital_output_bits"
    ),
    UINT8: "tool_output_mode tool_digital_output0_mode tool_digital_output1_mode",
}

# since which software of the e-Series (5.x) and of the CB3 (3.x) the controller knows a variable
SINCE: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "payload": ((5, 6), (3, 11)),
    "payload_cog": ((5, 6), (3, 11)),
    "payload_inertia": ((5, 11), (3, 15)),
    "ft_raw_wrench": ((5, 9), (9, 0)),
    "actual_current_as_torque": ((5, 23), (9, 0)),
}


def _register_types(direction: str) -> dict[str, str]:
    table = {f"{direction}_int_register_{i}": INT32 for i in range(48)}
    table |= {f"{direction}_double_register_{i}": DOUBLE for i in range(48)}
    return table | {f"{direction}_bit_register_{i}": BOOL for i in range(64, 128)}


def _types_by_name(groups: dict[str, str]) -> dict[str, str]:
    return {name: kind for kind, names in groups.items() for name in names.split()}


INPUT_TYPES: dict[str, str] = _types_by_name(_INPUTS) | _register_types("input")
OUTPUT_TYPES: dict[str, str] = (
    _types_by_name(_OUTPUTS)
    | _register_types("output")
    | {name: kind for name, kind in INPUT_TYPES.items() if name.startswith("input_")}
)


def is_available(name: str, version: tuple[int, ...]) -> bool:
    """Whether a controller of this software version has the variable."""
    since = SINCE.get(name)
    if since is None:
        return True
    first_version = since[1] if version[0] == 3 else since[0]
    return tuple(version[:2]) >= first_version


def zero_value(kind: str) -> object:
    """Return the value of a variable that was never set."""
    if kind in (VECTOR3D, VECTOR6D, VECTOR6INT32):
        return (0.0 if kind != VECTOR6INT32 else 0,) * (3 if kind == VECTOR3D else 6)
    return {BOOL: False, DOUBLE: 0.0}.get(kind, 0)


def package_layout(kinds: list[str], *, with_recipe_id: bool) -> Struct:
    """Return the big-endian layout of a data package."""
    return Struct(">" + ("B" if with_recipe_id else "") + "".join(_CODES[kind] for kind in kinds))


def value_count(kind: str) -> int:
    """Return how many numbers one variable of a type has."""
    code = _CODES[kind]
    return int(code[:-1]) if len(code) > 1 else 1
