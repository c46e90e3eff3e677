"""The unknowns of an identification: their names, their priors in physical units, and the arm they describe.

Derivatives by *any* parameter of the arm's fixed geometry are combinations, the same for all postures, of the
derivatives by right twists of the placements (`calibration.arm.kinematics`). So the data are met once, with
twists, and a small constant matrix turns twists into parameters.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.joint_terms import JointTerm
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array, adjoint_matrix, exp_twist, inverse_transform
from cellcal.calibration.identification.observations import DevicePlacement, Rows

FRAMES, OFFSETS, GEOMETRY, GRAVITY, RIPPLE, GEAR = range(6)
LEVEL_NAMES = (
    "base and tool only",
    "mastering offsets",
    "full geometry",
    "geometry and sag under gravity",
    "geometry, sag and gear ripple",
    "geometry, sag, ripple and gear ratios",
)


@dataclass(frozen=True, slots=True)
class Priors:
    """The expected distance of parameters from their nominal values: one standard deviation each."""

    offset_rad: float = float(np.deg2rad(0.5))
    slide_m: float = 2e-3  # zero of a joint that slides
    length_m: float = 1e-3
    angle_rad: float = float(np.deg2rad(0.2))
    sag_rad_per_m: float = float(np.deg2rad(0.1))
    # Tight: looser short ripple predicts other rows of a series slightly better and another series far worse.
    ripple_rad: float = float(np.deg2rad(0.003))
    gear_ratio: float = 1e-4  # of ratios and couplings: tooth counts are exact, belts and linkages nearly
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
    role: str  # base | anchor | wire | tool | offset | geometry | gravity | harmonic | gear
    joint: int = -1


@dataclass(frozen=True, eq=False)
class ArmState:
    """An arm with its errors, its tool, and the devices that look at it."""

    nominal: RobotModel
    geometry: Array  # (n, 5) DH errors, or (n + 1, 6) twists for a model without a DH table
    terms: tuple[JointTerm, ...]
    coefficients: Array  # (K,)
    flange_tool: Array  # (4, 4)
    devices: tuple[DevicePlacement, ...]
    further: tuple[Array, ...] = ()  # (4, 4) targets of mountings 1 and on, before one device that stays

    @property
    def mounting_count(self) -> int:
        """The number of mountings of the rows: of a device that moves, or of targets before one that stays."""
        return len(self.devices) + len(self.further)

    def device_of(self, mounting: int) -> DevicePlacement:
        """Return the device that a mounting's rows are from."""
        return self.devices[0 if self.further else mounting]

    def target_of(self, mounting: int) -> Array:
        """Return the target in the flange (4, 4) that a mounting's rows see."""
        return self.further[mounting - 1] if self.further and mounting else self.flange_tool

    @cached_property
    def arm_model(self) -> RobotModel:
        """The arm with its geometry errors; tool, devices and joint terms are not in it."""
        if not self.geometry.any():
            return self.nominal
        if self.nominal.dh is None:
            return self.nominal.with_twists(self.geometry)
        return self.nominal.with_dh_errors(self.geometry)

    def geometry_twists_of(self, mounting: int) -> Array:
        """Return `geometry_twists` before the target of a mounting: the same for all that see this target."""
        target = mounting if self.further else 0
        if target not in self._twists_by_target:
            self._twists_by_target[target] = geometry_twists(self.arm_model, self.target_of(mounting))
        return self._twists_by_target[target]

    @cached_property
    def _twists_by_target(self) -> dict[int, Array]:
        return {}

    def seen_from(self, mounting: int) -> RobotModel:
        """Return the arm whose base is the device's frame and whose flange is the target."""
        placements = self.arm_model.placements.copy()
        placements[0] = self.device_of(mounting).device_base @ placements[0]
        placements[-1] = placements[-1] @ self.target_of(mounting)
        return replace(self.arm_model, dh=None, placements=placements)

    def moved_joints(self, joints_rad: Array, values: Array) -> Array:
        """Return the controller joints that carry sag and ripple; ``values`` (K, N) from `term_values`."""
        if not len(self.terms):
            return joints_rad
        extra = np.zeros((self.nominal.axis_count, len(joints_rad)))
        for term, coefficient, value in zip(self.terms, self.coefficients, values, strict=True):
            extra[term.joint] += coefficient * value
        moved: Array = joints_rad + np.linalg.solve(self.nominal.joint_coupling, extra).T
        return moved


def nominal_state(
    model: RobotModel, devices: tuple[DevicePlacement, ...], flange_tool: Array | None = None
) -> ArmState:
    """Return the nominal arm with these devices and tool."""
    geometry = np.zeros((model.axis_count, 5) if model.dh is not None else (model.axis_count + 1, 6))
    tool = np.eye(4) if flange_tool is None else flange_tool
    return ArmState(model, geometry, (), np.zeros(0), tool, devices)


@dataclass(frozen=True, eq=False)
class ParameterLayout:
    """The free unknowns, their order, and how a step of them changes the arm."""

    parameters: tuple[Parameter, ...]
    kind: str  # of observation
    mountings: int
    geometry: tuple[tuple[int, int], ...]  # entries of ArmState.geometry that are free
    terms: int
    further: int = field(default=0, kw_only=True)  # targets behind the first; then the device stays

    def __len__(self) -> int:
        return len(self.parameters)

    @cached_property
    def prior_sigmas(self) -> Array:
        """Prior standard deviations (p,)."""
        return np.array([parameter.prior for parameter in self.parameters])

    @cached_property
    def _tool_size(self) -> int:
        return 6 if self.kind == "pose" else 3

    @cached_property
    def _place_size(self) -> int:
        return 3 if self.kind == "length" else 6

    @cached_property
    def shared_count(self) -> int:
        """The number of parameters before the tool's: places of the device, and zero and scale of a wire."""
        return self._place_size * self.mountings + (2 if self._has_wire else 0)

    @cached_property
    def _behind_tools(self) -> int:
        return self.shared_count + self._tool_size * (1 + self.further)

    def target_slice(self, mounting: int) -> slice:
        """Return which parameters are the place of a mounting's target."""
        first = self.shared_count + (self._tool_size * mounting if self.further else 0)
        return slice(first, first + self._tool_size)

    @cached_property
    def _has_wire(self) -> bool:
        return any(parameter.role == "wire" for parameter in self.parameters)

    @cached_property
    def _geometry_entries(self) -> tuple[Rows, Rows]:
        rows, columns = zip(*self.geometry, strict=True)
        return np.array(rows), np.array(columns)

    def prior_deviations(self, state: ArmState) -> Array:
        """Return how far each parameter is from its prior mean (p,); places and tools have none, so zero."""
        deviation = np.zeros(len(self))
        if self._has_wire:
            device = state.devices[0]
            deviation[self.shared_count - 2 : self.shared_count] = device.zero_m, device.scale - 1.0
        first = self._behind_tools
        if self.geometry:
            deviation[first : first + len(self.geometry)] = state.geometry[self._geometry_entries]
        if self.terms:
            deviation[-self.terms :] = state.coefficients
        return deviation

    def tangent_rows(self, state: ArmState, mounting: int) -> Array:
        """Return (p, 6 (n + 1) + K + D): each parameter as twists of placements, terms, device columns."""
        n = state.nominal.axis_count
        own = 5 if self.kind == "length" else 0
        matrix = np.zeros((len(self), 6 * (n + 1) + len(state.terms) + own))
        device = 0 if self.further else mounting
        place = slice(self._place_size * device, self._place_size * (device + 1))
        if self.kind == "length":
            matrix[place, -5:-2] = np.eye(3)
            if self._has_wire:
                matrix[self.shared_count - 2 : self.shared_count, -2:] = np.eye(2)
        else:
            matrix[place, :6] = adjoint_matrix(inverse_transform(state.arm_model.placements[0])).T
        matrix[self.target_slice(mounting), 6 * n : 6 * n + self._tool_size] = np.eye(self._tool_size)
        first = self._behind_tools
        if self.geometry:
            rows, columns = self._geometry_entries
            matrix[first : first + len(self.geometry), : 6 * (n + 1)] = state.geometry_twists_of(mounting)[
                rows, columns
            ]
        if self.terms:
            rows = np.arange(len(self) - self.terms, len(self))
            matrix[rows, 6 * (n + 1) + np.arange(self.terms)] = 1.0
        return matrix

    def apply_step(self, state: ArmState, change: Array) -> ArmState:
        """Return the state after a step of the parameters (p,)."""
        frames = 0 if self.kind == "length" else self.mountings
        moves = self._small_motions(change, frames)
        first = self._behind_tools
        geometry = state.geometry
        if self.geometry:
            geometry = geometry.copy()
            geometry[self._geometry_entries] += change[first : first + len(self.geometry)]
        coefficients = state.coefficients + change[-self.terms :] if self.terms else state.coefficients
        return ArmState(
            state.nominal,
            geometry,
            state.terms,
            coefficients,
            state.flange_tool @ moves[frames],
            tuple(self._move_device(device, i, change, moves) for i, device in enumerate(state.devices)),
            tuple(target @ moves[frames + 1 + i] for i, target in enumerate(state.further)),
        )

    def _small_motions(self, change: Array, frames: int) -> Array:
        """Return the small motions (4, 4) of so many device frames, then of every target, all at once."""
        twists = np.zeros((frames + 1 + self.further, 6))
        twists[:frames] = change[: 6 * frames].reshape(frames, 6)
        targets = change[self.shared_count : self._behind_tools].reshape(-1, self._tool_size)
        twists[frames:, : self._tool_size] = targets
        return exp_twist(twists)

    def _move_device(
        self, device: DevicePlacement, mounting: int, change: Array, moves: Array
    ) -> DevicePlacement:
        if self.kind != "length":
            return DevicePlacement(device.device_base @ moves[mounting], device.anchor_in_base_m)
        zero, scale = change[self.shared_count - 2 : self.shared_count] if self._has_wire else (0.0, 0.0)
        return DevicePlacement(
            device.device_base,
            device.anchor_in_base_m + change[3 * mounting : 3 * mounting + 3],
            device.zero_m + float(zero),
            device.scale + float(scale),
        )


def geometry_twists(arm: RobotModel, flange_tool: Array) -> Array:
    """Return the twists of the placements that every entry of the geometry stands for (…, 6 (n + 1))."""
    n = arm.axis_count
    if arm.dh is None:
        maps = np.eye(6 * (n + 1)).reshape(n + 1, 6, n + 1, 6)
    else:
        maps = np.zeros((n, 5, n + 1, 6))
        rows = np.arange(n)
        maps[rows, 0, rows, 5] = 1.0  # theta turns about z of the placement before
        maps[rows, 1:, rows + 1] = _row_twists(arm.dh.alpha_rad, arm.dh.beta_rad)
    # Behind the last placement stands the tool.
    maps[:, :, n] = maps[:, :, n] @ adjoint_matrix(inverse_transform(flange_tool)).T
    return maps.reshape(*maps.shape[:2], -1)


def _row_twists(alpha_rad: Array, beta_rad: Array) -> Array:
    """Return (n, 4, 6): d, a, alpha, beta of DH rows as right twists of their placements."""
    cb, sb = np.cos(beta_rad), np.sin(beta_rad)
    twists = np.zeros((len(cb), 4, 6))
    twists[:, 0, 0], twists[:, 0, 1], twists[:, 0, 2] = (
        -sb * np.cos(alpha_rad),
        np.sin(alpha_rad),
        cb * np.cos(alpha_rad),
    )
    twists[:, 1, 0], twists[:, 1, 2] = cb, sb  # x of the row seen after Rot(y, beta)
    twists[:, 2, 3], twists[:, 2, 5] = cb, sb
    twists[:, 3, 4] = 1.0
    return twists
