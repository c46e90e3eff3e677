"""The unknowns of a level of identification, with their names, units and priors."""

from dataclasses import replace

from cellcal.calibration.arm.joint_terms import JointTerm
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.identification.parameters import FRAMES, GEOMETRY, Parameter, ParameterLayout, Priors

_AXES = ("x", "y", "z", "rx", "ry", "rz")
# Gears that are mounted off centre, springs and counterbalances: one and two waves a turn are larger than the others.
_LONG_WAVES = {1: 3.0, 2: 2.0}  # times the prior of ripple, by order
_DH_NAMES = ("offset", "d", "a", "alpha", "beta")
_DH_UNITS = ("rad", "m", "m", "rad", "rad")


def make_layout(
    model: RobotModel,
    kind: str,
    mountings: int,
    *,
    level: int,
    terms: tuple[JointTerm, ...] = (),
    priors: Priors | None = None,
) -> ParameterLayout:
    """Return the unknowns of a level, in the order: devices, tool, geometry, joint terms."""
    priors = priors or Priors()
    entries, geometry = geometry_parameters(model, level, priors)
    extra = term_parameters(terms, priors)
    parameters = [
        *_device_parameters(kind, mountings, level, priors),
        *_tool_parameters("tool", kind, priors),
        *geometry,
        *extra,
    ]
    return ParameterLayout(tuple(parameters), kind, mountings, tuple(entries), len(extra))


def with_further(layout: ParameterLayout, further: int, priors: Priors) -> ParameterLayout:
    """Return a layout of one target with the unknown places of so many more behind it.

    Raises
    ------
    CalibrationError
        Further targets before a device that moves: a mounting tells one of both.
    """
    if not further:
        return layout
    if layout.mountings > 1:
        raise CalibrationError("several targets are fitted together before one device that stays")
    behind = layout.target_slice(0).stop
    more = [
        each for k in range(1, further + 1) for each in _tool_parameters(f"point {k}", layout.kind, priors)
    ]
    parameters = (*layout.parameters[:behind], *more, *layout.parameters[behind:])
    return replace(layout, parameters=parameters, further=further)


def term_parameters(terms: tuple[JointTerm, ...], priors: Priors) -> list[Parameter]:
    """Return the unknown coefficients of joint terms."""
    sizes = {
        "gravity": ("rad/m", priors.sag_rad_per_m),
        "harmonic": ("rad", priors.ripple_rad),
        "gear": ("1", priors.gear_ratio),
    }
    parameters = []
    for term in terms:
        unit, prior = sizes[term.kind]
        longer = _LONG_WAVES.get(term.order, 1.0) if term.kind == "harmonic" else 1.0
        parameters.append(Parameter(term.name, unit, longer * prior, term.kind, term.joint))
    return parameters


def _device_parameters(kind: str, mountings: int, level: int, priors: Priors) -> list[Parameter]:
    what = "anchor" if kind == "length" else "base"
    names = _AXES[:3] if kind == "length" else _AXES
    many = [f" {i + 1}" for i in range(mountings)] if mountings > 1 else [""]
    found = [
        Parameter(f"{what}{number} {axis}", *_place_prior(axis, priors), what)
        for number in many
        for axis in names
    ]
    if kind == "length" and level > FRAMES:
        found.append(Parameter("wire zero", "m", priors.wire_zero_m, "wire"))
        found.append(Parameter("wire scale", "1", priors.wire_scale, "wire"))
    return found


def _tool_parameters(what: str, kind: str, priors: Priors) -> list[Parameter]:
    names = _AXES if kind == "pose" else _AXES[:3]
    return [Parameter(f"{what} {axis}", *_place_prior(axis, priors), "tool") for axis in names]


def _place_prior(axis: str, priors: Priors) -> tuple[str, float]:
    return ("rad", priors.turn_rad) if axis.startswith("r") else ("m", priors.place_m)


def geometry_parameters(
    model: RobotModel, level: int, priors: Priors
) -> tuple[list[tuple[int, int]], list[Parameter]]:
    """Return the entries of `ArmState.geometry` that a level frees, and the unknowns they are."""
    if level == FRAMES:
        return [], []
    n = model.axis_count
    sizes = {"m": priors.length_m, "rad": priors.angle_rad}
    if model.dh is not None:
        entries = [(i, column) for i in range(n) for column in range(5 if level >= GEOMETRY else 1)]
        return entries, [
            Parameter(f"J{i + 1} offset", "rad", priors.offset_rad, "offset", i)
            if column == 0
            else Parameter(
                f"J{i + 1} {_DH_NAMES[column]}", _DH_UNITS[column], sizes[_DH_UNITS[column]], "geometry", i
            )
            for i, column in entries
        ]
    # The first placement is the base's and the last the tool's, except for the motion of the next joint.
    own = model.joint_twists
    entries = [
        (k, axis) for k in range(n) for axis in range(6) if axis == own[k] or (k > 0 and level >= GEOMETRY)
    ]
    zeros = {5: ("rad", priors.offset_rad), 2: ("m", priors.slide_m)}
    return entries, [
        Parameter(f"J{k + 1} offset", *zeros[int(own[k])], "offset", k)
        if axis == own[k]
        else Parameter(
            f"J{k + 1} placement {_AXES[axis]}",
            "m" if axis < 3 else "rad",
            sizes["m" if axis < 3 else "rad"],
            "geometry",
            k,
        )
        for k, axis in entries
    ]
