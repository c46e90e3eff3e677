"""The unknowns of an identification: their names, their priors in physical units, and the arm they describe.

Derivatives by *any* parameter of the arm's fixed geometry are combinations, the same for all postures, of the
derivatives by right twists of the placements (`calibration.kinematics`). So the data are met once, with
twists, and a small constant matrix turns twists into parameters.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calibration.geometry import Array, exp_twist, inverse_transform, skew
from calibration.joint_terms import JointTerm
from calibration.kinematics import RobotModel
from calibration.observations import Device

FRAMES, OFFSETS, GEOMETRY, GRAVITY, RIPPLE = range(5)
LEVEL_NAMES = (
    "base and tool only",
    "mastering offsets",
    "full geometry",
    "geometry and sag under gravity",
    "geometry, sag and gear ripple",
)
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_DH_NAMES = ("offset", "d", "a", "alpha", "beta")
_DH_UNITS = ("rad", "m", "m", "rad", "rad")


@dataclass(frozen=True, slots=True)
class Priors:
    """How far a parameter may be expected from its nominal value: one standard deviation each."""

    offset_rad: float = float(np.deg2rad(0.5))
    length_m: float = 1e-3
    angle_rad: float = float(np.deg2rad(0.2))
    sag_rad_per_m: float = float(np.deg2rad(0.1))
    # Tight: looser ripple predicts other rows of a series slightly better and another series far worse.
    ripple_rad: float = float(np.deg2rad(0.003))
    wire_zero_m: float = 1e-3
    wire_scale: float = 1e-3
    place_m: float = 10.0  # where devices and tools are is not known beforehand
    turn_rad: float = 10.0


@dataclass(frozen=True, slots=True)
class Parameter:
    """One unknown: what people call it, its unit, one prior standard deviation, and what it belongs to."""

    name: str
    unit: str  # m | rad | rad/m | 1
    prior: float
    role: str  # base | anchor | wire | tool | offset | geometry | gravity | harmonic
    joint: int = -1


@dataclass(frozen=True, eq=False)
class ArmState:
    """An arm with its errors, its tool, and the devices that look at it."""

    nominal: RobotModel
    geometry: Array  # (n, 5) DH errors, or (n + 1, 6) twists for a model without a DH table
    terms: tuple[JointTerm, ...]
    coefficients: Array  # (K,)
    flange_tool: Array  # (4, 4)
    devices: tuple[Device, ...]

    @cached_property
    def arm(self) -> RobotModel:
        """The arm with its geometry errors; tool, devices and joint terms are not in it."""
        if not self.geometry.any():
            return self.nominal
        if self.nominal.dh is None:
            return self.nominal.with_twists(self.geometry)
        return self.nominal.with_dh_errors(self.geometry)

    def seen_from(self, mounting: int) -> RobotModel:
        """Return the arm whose base is the device's frame and whose flange is the target."""
        placements = self.arm.placements.copy()
        placements[0] = self.devices[mounting].device_base @ placements[0]
        placements[-1] = placements[-1] @ self.flange_tool
        return replace(self.arm, dh=None, placements=placements)

    def moved_joints(self, joints_rad: Array, values: Array) -> Array:
        """Return the controller joints that carry sag and ripple; ``values`` (K, N) from `term_values`."""
        if not len(self.terms):
            return joints_rad
        extra = np.zeros((self.nominal.axes, len(joints_rad)))
        for term, coefficient, value in zip(self.terms, self.coefficients, values, strict=True):
            extra[term.joint] += coefficient * value
        moved: Array = joints_rad + np.linalg.solve(self.nominal.joint_coupling, extra).T
        return moved


def nominal_state(
    model: RobotModel, devices: tuple[Device, ...], flange_tool: Array | None = None
) -> ArmState:
    """Return the nominal arm with these devices and tool."""
    geometry = np.zeros((model.axes, 5) if model.dh is not None else (model.axes + 1, 6))
    tool = np.eye(4) if flange_tool is None else flange_tool
    return ArmState(model, geometry, (), np.zeros(0), tool, devices)


@dataclass(frozen=True, eq=False)
class Layout:
    """Which unknowns are free, in which order, and how a step of them changes the arm."""

    parameters: tuple[Parameter, ...]
    kind: str  # of observation
    mountings: int
    geometry: tuple[tuple[int, int], ...]  # entries of ArmState.geometry that are free
    terms: int

    def __len__(self) -> int:
        return len(self.parameters)

    @cached_property
    def prior(self) -> Array:
        """Prior standard deviations (p,)."""
        return np.array([parameter.prior for parameter in self.parameters])

    @property
    def _tool_size(self) -> int:
        return 6 if self.kind == "pose" else 3

    @property
    def _place_size(self) -> int:
        return 3 if self.kind == "length" else 6

    @property
    def shared(self) -> int:
        """How many parameters stand before the tool: places of the device, and zero and scale of a wire."""
        return self._place_size * self.mountings + (2 if self._has_wire else 0)

    @cached_property
    def _has_wire(self) -> bool:
        return any(parameter.role == "wire" for parameter in self.parameters)

    def deviations(self, state: ArmState) -> Array:
        """Return how far each parameter is from its prior mean (p,); places and tools have none, so zero."""
        deviation = np.zeros(len(self))
        if self._has_wire:
            device = state.devices[0]
            deviation[self.shared - 2 : self.shared] = device.zero_m, device.scale - 1.0
        first = self.shared + self._tool_size
        deviation[first : first + len(self.geometry)] = [state.geometry[entry] for entry in self.geometry]
        if self.terms:
            deviation[-self.terms :] = state.coefficients
        return deviation

    def tangent(self, state: ArmState, mounting: int) -> Array:
        """Return (p, 6 (n + 1) + K + D): each parameter as twists of placements, terms, device columns."""
        n = state.nominal.axes
        own = 5 if self.kind == "length" else 0
        matrix = np.zeros((len(self), 6 * (n + 1) + len(state.terms) + own))
        place = slice(self._place_size * mounting, self._place_size * (mounting + 1))
        if self.kind == "length":
            matrix[place, -5:-2] = np.eye(3)
            if self._has_wire:
                matrix[self.shared - 2 : self.shared, -2:] = np.eye(2)
        else:
            matrix[place, :6] = adjoint(inverse_transform(state.arm.placements[0])).T
        tool = self.shared
        matrix[tool : tool + self._tool_size, 6 * n : 6 * n + self._tool_size] = np.eye(self._tool_size)
        first = tool + self._tool_size
        maps = geometry_twists(state)
        for row, entry in enumerate(self.geometry, start=first):
            matrix[row, : 6 * (n + 1)] = maps[entry]
        if self.terms:
            rows = np.arange(len(self) - self.terms, len(self))
            matrix[rows, 6 * (n + 1) + np.arange(self.terms)] = 1.0
        return matrix

    def step(self, state: ArmState, change: Array) -> ArmState:
        """Return the state after a step of the parameters (p,)."""
        devices = tuple(self._moved(device, i, change) for i, device in enumerate(state.devices))
        twist = np.zeros(6)
        twist[: self._tool_size] = change[self.shared : self.shared + self._tool_size]
        geometry = state.geometry.copy()
        first = self.shared + self._tool_size
        for row, entry in enumerate(self.geometry, start=first):
            geometry[entry] += change[row]
        coefficients = state.coefficients + change[-self.terms :] if self.terms else state.coefficients
        return replace(
            state,
            geometry=geometry,
            coefficients=coefficients,
            flange_tool=state.flange_tool @ exp_twist(twist),
            devices=devices,
        )

    def _moved(self, device: Device, mounting: int, change: Array) -> Device:
        place = change[self._place_size * mounting : self._place_size * (mounting + 1)]
        if self.kind != "length":
            return replace(device, device_base=device.device_base @ exp_twist(place))
        zero, scale = change[self.shared - 2 : self.shared] if self._has_wire else (0.0, 0.0)
        return Device(
            device.device_base,
            device.anchor_in_base_m + place,
            device.zero_m + float(zero),
            device.scale + float(scale),
        )


def make_layout(
    model: RobotModel,
    kind: str,
    mountings: int,
    *,
    level: int,
    terms: tuple[JointTerm, ...] = (),
    priors: Priors | None = None,
) -> Layout:
    """Return the unknowns of a level, in the order: devices, tool, geometry, joint terms."""
    priors = priors or Priors()
    entries, geometry = _geometry_parameters(model, level, priors)
    sag = {"gravity": ("rad/m", priors.sag_rad_per_m), "harmonic": ("rad", priors.ripple_rad)}
    extra = [Parameter(t.name, *sag[t.kind], t.kind, t.joint) for t in terms]
    parameters = [
        *_device_parameters(kind, mountings, level, priors),
        *_tool_parameters(kind, priors),
        *geometry,
        *extra,
    ]
    return Layout(tuple(parameters), kind, mountings, tuple(entries), len(extra))


def adjoint(transform: Array) -> Array:
    """Return (6, 6): twists (v, w) seen through a rigid transform, ``T exp(x) = exp(Ad x) T``."""
    rotation, position = transform[:3, :3], transform[:3, 3]
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = rotation
    matrix[:3, 3:] = skew(position) @ rotation
    return matrix


def geometry_twists(state: ArmState) -> dict[tuple[int, int], Array]:
    """Return, for every entry of the geometry, the twists of the placements it stands for (6 (n + 1),)."""
    n, arm = state.nominal.axes, state.arm
    maps: dict[tuple[int, int], Array] = {}
    last = adjoint(inverse_transform(state.flange_tool))
    if arm.dh is None:
        for k in range(n + 1):
            for axis in range(6):
                twist = np.eye(6)[axis]
                maps[k, axis] = _placed(n, k, last @ twist if k == n else twist)
        return maps
    for i in range(n):
        maps[i, 0] = _placed(n, i, np.eye(6)[5])
        for column, twist in enumerate(_row_twists(arm.dh.alpha_rad[i], arm.dh.beta_rad[i]), start=1):
            maps[i, column] = _placed(n, i + 1, last @ twist if i == n - 1 else twist)
    return maps


def _row_twists(alpha: float, beta: float) -> Array:
    """Return (4, 6): d, a, alpha, beta of a DH row as right twists of its placement."""
    cb, sb = np.cos(beta), np.sin(beta)
    x = np.array([cb, 0.0, sb])  # the row's x seen after Rot(y, beta)
    z = np.array([-sb * np.cos(alpha), np.sin(alpha), cb * np.cos(alpha)])
    twists = np.zeros((4, 6))
    twists[0, :3], twists[1, :3], twists[2, 3:], twists[3, 4] = z, x, x, 1.0
    return twists


def _placed(n: int, placement: int, twist: Array) -> Array:
    row = np.zeros(6 * (n + 1))
    row[6 * placement : 6 * placement + 6] = twist
    return row


def _device_parameters(kind: str, mountings: int, level: int, priors: Priors) -> list[Parameter]:
    what = "anchor" if kind == "length" else "base"
    names = _AXES[:3] if kind == "length" else _AXES
    many = [f" {i + 1}" for i in range(mountings)] if mountings > 1 else [""]
    found = [
        Parameter(f"{what}{number} {axis}", *_place(axis, priors), what) for number in many for axis in names
    ]
    if kind == "length" and level > FRAMES:
        found.append(Parameter("wire zero", "m", priors.wire_zero_m, "wire"))
        found.append(Parameter("wire scale", "1", priors.wire_scale, "wire"))
    return found


def _tool_parameters(kind: str, priors: Priors) -> list[Parameter]:
    names = _AXES if kind == "pose" else _AXES[:3]
    return [Parameter(f"tool {axis}", *_place(axis, priors), "tool") for axis in names]


def _place(axis: str, priors: Priors) -> tuple[str, float]:
    return ("rad", priors.turn_rad) if axis.startswith("r") else ("m", priors.place_m)


def _geometry_parameters(
    model: RobotModel, level: int, priors: Priors
) -> tuple[list[tuple[int, int]], list[Parameter]]:
    if level == FRAMES:
        return [], []
    n = model.axes
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
    # The first placement is the base's and the last the tool's, except for the turn about the next joint.
    entries = [(k, axis) for k in range(n) for axis in range(6) if axis == 5 or (k > 0 and level >= GEOMETRY)]
    return entries, [
        Parameter(f"J{k + 1} offset", "rad", priors.offset_rad, "offset", k)
        if axis == 5
        else Parameter(
            f"J{k + 1} placement {_AXES[axis]}",
            "m" if axis < 3 else "rad",
            sizes["m" if axis < 3 else "rad"],
            "geometry",
            k,
        )
        for k, axis in entries
    ]
