"""The unknowns of a cell: frames, numbers of devices and arms, in one vector; and what a step of it changes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cellcal.calibration.arm.joint_terms import JointTerm
from cellcal.calibration.cells.cell import CalibrationCell, CellDevice, CellRobot, CellTool, DeviceScalar
from cellcal.calibration.cells.frame_priors import AXES, FramePrior, move_frames
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, adjoint_matrix, inverse_transform
from cellcal.calibration.identification.layouts import geometry_parameters, term_parameters
from cellcal.calibration.identification.observations import DevicePlacement, Rows
from cellcal.calibration.identification.parameters import (
    FRAMES,
    ArmState,
    Parameter,
    Priors,
    geometry_twists,
    nominal_state,
)
from cellcal.calibration.message import make_message

SCALARS = ("zero_m", "scale", "radius_m")
_SCALAR_NAMES = {"zero_m": ("zero", "m"), "scale": ("scale", "1"), "radius_m": ("radius", "m")}
_EXPECTED = np.array([0.0, 1.0, 0.0])
NOWHERE = -1


@dataclass(frozen=True, eq=False)
class FrameSlot:
    """One frame among the unknowns."""

    name: str
    role: str  # base | tool | target | device
    place: FramePrior


@dataclass(frozen=True, slots=True)
class FrameRoute:
    """The frames between a device and a target: numbers of slots, or NOWHERE for the identity."""

    arm: int
    base: int
    tool: int
    target: int
    device: int = NOWHERE


@dataclass(frozen=True, eq=False)
class CellState:
    """Arms with their errors, and every frame and number of the cell."""

    arms: tuple[ArmState, ...]  # without tool and devices
    places: Array  # (M, 4, 4), one a slot
    scalars: Array  # (D, 3): zero [m], scale [1], radius [m] of every device

    def along_route(self, route: FrameRoute, device: int = NOWHERE) -> "ArmAlongRoute":
        """Return what stands between a route's device, or the world, and its target."""
        arm, base, tool = self.arms[route.arm], self.places[route.base], self.places[route.tool]
        if route.device != NOWHERE:
            base = inverse_transform(self.places[route.device]) @ base
        if route.target != NOWHERE:
            tool = tool @ self.places[route.target]
        placements = arm.arm_model.placements.copy()
        placements[0], placements[-1] = base @ placements[0], placements[-1] @ tool
        numbers = _EXPECTED if device == NOWHERE else self.scalars[device]
        device_state = DevicePlacement(np.eye(4), np.zeros(3), *(float(v) for v in numbers))
        return ArmAlongRoute(arm, tool, placements, device_state)


@dataclass(frozen=True, eq=False)
class ArmAlongRoute:
    """The arm between a device's frame and a target, which is where the device's own numbers apply."""

    arm: ArmState
    flange_target: Array  # (4, 4)
    placements: Array  # (n + 1, 4, 4)
    device: DevicePlacement


@dataclass(frozen=True, eq=False)
class CellFrames:
    """The slots of a cell, and the routes through them."""

    cell: CalibrationCell
    slots: tuple[FrameSlot, ...]
    names: dict[tuple[str, str], int]  # (role, name) to the first of its slots

    @classmethod
    def from_cell(cls, cell: CalibrationCell) -> "CellFrames":
        """Lay out the frames of a cell: bases, tools, targets, devices.

        Raises
        ------
        CalibrationError
            Nothing ties a robot or device to the world.
        """
        slots: list[FrameSlot] = []
        names: dict[tuple[str, str], int] = {}
        for name, slot in _list_slots(cell):
            names.setdefault((slot.role, name), len(slots))
            slots.append(slot)
        frames = cls(cell, tuple(slots), names)
        _refuse_loose(frames)
        return frames

    def find_route(self, target: str, device: str = "", mounting: int = 0) -> FrameRoute:
        """Return the way from a device, or from the world, to a target."""
        robot = self.cell.robot_of(target)
        return FrameRoute(
            [r.name for r in self.cell.robots].index(robot.name),
            self.names["base", robot.name],
            self.names["tool", self.cell.tool_of(target).name],
            self.names.get(("target", target), NOWHERE),
            self.names["device", device] + mounting if device else NOWHERE,
        )

    def device_number(self, name: str) -> int:
        """Return which device has this name."""
        return [device.name for device in self.cell.devices].index(name)


def _list_slots(cell: CalibrationCell) -> Iterator[tuple[str, FrameSlot]]:
    for i, robot in enumerate(cell.robots):
        world = FramePrior.from_pose(np.eye(4)) if i == 0 else FramePrior.without_prior()
        yield (
            robot.name,
            FrameSlot(
                make_message("base of {robot_name}", robot_name=robot.name), "base", robot.base or world
            ),
        )
    for tool in cell.tools:
        label = "tool" if len(cell.tools) == 1 else f"tool {tool.name}"
        yield tool.name, FrameSlot(label, "tool", tool.place or _default_tool(cell, tool))
    for target in cell.targets:
        yield (
            target.name,
            FrameSlot(make_message("target {target_name}", target_name=target.name), "target", target.place),
        )
    for device in cell.devices:
        axes = {a for s in cell.series if s.device == device.name for a in s.observations.place_axes}
        for i, place in enumerate(device.places):
            label = device.name if len(device.places) == 1 else f"{device.name} {i + 1}"
            yield device.name, FrameSlot(label, "device", place.free_axes_only(tuple(sorted(axes))))


def _default_tool(cell: CalibrationCell, tool: CellTool) -> FramePrior:
    here = [s for s in cell.series if cell.tool_of(s.target) is tool]
    aside = {target.name for target in cell.targets if target.tool == tool.name}
    turning_shows = any(s.observations.needs_rotation or s.target in aside for s in here)
    return FramePrior.without_prior() if turning_shows else FramePrior.point_without_prior()


def _refuse_loose(frames: CellFrames) -> None:
    """Refuse robots and devices whose place in the world nothing tells."""
    cell = frames.cell
    tied = {slot for slot in frames.names.values() if frames.slots[slot].place.has_position_prior}
    links = [
        (frames.find_route(s.target).base, frames.names["device", s.device])
        for s in cell.series
        if s.observations.place_axes
    ]
    for _ in links:
        tied |= {end for link in links if tied & set(link) for end in link}
    for robot in cell.robots:
        is_measured = any(cell.robot_of(s.target) is robot for s in cell.series)
        if is_measured and frames.names["base", robot.name] not in tied:
            raise CalibrationError(
                make_message("nothing tells where robot {name!r} stands in the world.", name=robot.name),
                remedy="Let one device see both robots, or give the base's place or a device's.",
            )


@dataclass(frozen=True, eq=False)
class CellLayout:
    """The free ones of all unknowns. The whole vector holds six numbers a slot, three a device, then the arms."""

    frames: CellFrames
    whole: tuple[Parameter, ...]
    free: Rows  # numbers of free unknowns in the whole vector
    entries: tuple[tuple[tuple[int, int], ...], ...]  # free entries of every arm's geometry
    expected: CellState  # mean of the priors of arms and numbers

    def __len__(self) -> int:
        return len(self.free)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free unknowns."""
        return tuple(self.whole[i] for i in self.free)

    @cached_property
    def prior_sigmas(self) -> Array:
        """Prior standard deviations (p,)."""
        return np.array([parameter.prior for parameter in self.parameters])

    def prior_deviations(self, state: CellState) -> Array:
        """Return how far each unknown is from its prior mean (p,); zero where there is none."""
        every = [self._slot_prior(i, state)[0] for i in range(len(self.frames.slots))]
        every.append((state.scalars - self.expected.scalars).reshape(-1))
        for arm, mean, entries in zip(state.arms, self.expected.arms, self.entries, strict=True):
            every.append(np.array([arm.geometry[e] - mean.geometry[e] for e in entries]))
            every.append(arm.coefficients - mean.coefficients)
        deviations: Array = np.concatenate(every)[self.free]
        return deviations

    def prior_equations(self, state: CellState) -> tuple[Array, Array, float]:
        """Return information, gradient and cost of the priors, in prior deviations."""
        ratio = self.prior_deviations(state) / self.prior_sigmas
        follows = np.eye(len(self))
        where = {int(number): i for i, number in enumerate(self.free)}
        for slot in range(len(self.frames.slots)):
            axes = [axis for axis in range(6) if 6 * slot + axis in where]
            rows = [where[6 * slot + axis] for axis in axes]
            slopes = self._slot_prior(slot, state)[1][np.ix_(axes, axes)]
            follows[np.ix_(rows, rows)] = slopes * self.prior_sigmas[rows] / self.prior_sigmas[rows][:, None]
        return follows.T @ follows, -follows.T @ ratio, float(ratio @ ratio)

    def _slot_prior(self, slot: int, state: CellState) -> tuple[Array, Array]:
        place = self.frames.slots[slot].place
        has_prior = np.isfinite(place.sigma) & (place.sigma > 0)
        if not has_prior.any():
            return np.zeros(6), np.eye(6)
        deviation, follows = place.deviation_of(state.places[slot])
        follows[~has_prior] = np.eye(6)[~has_prior]
        return np.where(has_prior, deviation, 0.0), follows

    def apply_step(self, state: CellState, change: Array) -> CellState:
        """Return the state after a step of the free unknowns (p,)."""
        every = np.zeros(len(self.whole))
        every[self.free] = change
        slots, devices = 6 * len(self.frames.slots), state.scalars.size
        places = move_frames(state.places, every[:slots].reshape(-1, 6))
        scalars = state.scalars + every[slots : slots + devices].reshape(-1, 3)
        first, arms = slots + devices, []
        for arm, entries in zip(state.arms, self.entries, strict=True):
            geometry = arm.geometry.copy()
            for i, entry in enumerate(entries):
                geometry[entry] += every[first + i]
            first += len(entries)
            coefficients = arm.coefficients + every[first : first + len(arm.terms)]
            first += len(arm.terms)
            arms.append(replace(arm, geometry=geometry, coefficients=coefficients))
        return CellState(tuple(arms), places, scalars)

    def tangent_rows(self, state: CellState, route: FrameRoute, device: int, own: tuple[str, ...]) -> Array:
        """Return (p, 6 (n + 1) + K + D): each free unknown as twists of a route's chain, terms, device columns."""
        along = state.along_route(route)
        n, terms = along.arm.nominal.axis_count, len(along.arm.terms)
        last = 6 * n
        matrix = np.zeros((len(self.whole), last + 6 + terms + len(own)))
        matrix[_slot_slice(route.base), :6] = adjoint_matrix(
            inverse_transform(along.arm.arm_model.placements[0])
        ).T
        if route.device != NOWHERE:
            # A robot may be seen from its own base: then both cancel.
            matrix[_slot_slice(route.device), :6] -= adjoint_matrix(inverse_transform(along.placements[0])).T
        turn = np.eye(6)
        if route.target != NOWHERE:
            turn = adjoint_matrix(inverse_transform(state.places[route.target])).T
            matrix[_slot_slice(route.target), last : last + 6] = np.eye(6)
        matrix[_slot_slice(route.tool), last : last + 6] = turn
        for i, name in enumerate(own):
            row = 6 * len(self.frames.slots) + 3 * device + SCALARS.index(name)
            matrix[row, last + 6 + terms + i] = 1.0
        start = self._arm_start(state, route.arm)
        entries = self.entries[route.arm]
        if entries:
            rows, columns = (list(part) for part in zip(*entries, strict=True))
            twists = geometry_twists(along.arm.arm_model, along.flange_target)
            matrix[start : start + len(entries), : last + 6] = twists[rows, columns]
        at = start + len(entries) + np.arange(terms)
        matrix[at, last + 6 + np.arange(terms)] = 1.0
        free: Array = matrix[self.free]
        return free

    def _arm_start(self, state: CellState, arm: int) -> int:
        before = zip(self.entries[:arm], state.arms[:arm], strict=True)
        arms = sum(len(entries) + len(other.terms) for entries, other in before)
        return 6 * len(self.frames.slots) + state.scalars.size + arms


def _slot_slice(slot: int) -> slice:
    return slice(6 * slot, 6 * slot + 6)


def cell_layout(
    frames: CellFrames, level: int, terms: Sequence[tuple[JointTerm, ...]], priors: Priors
) -> CellLayout:
    """Return the unknowns of a level; ``terms`` has those of every robot."""
    cell = frames.cell
    whole: list[Parameter] = []
    for slot in frames.slots:
        for axis, sigma in zip(AXES, slot.place.sigma, strict=True):
            unit, wide = ("rad", priors.turn_rad) if axis.startswith("r") else ("m", priors.place_m)
            prior = float(sigma) if np.isfinite(sigma) else wide
            whole.append(Parameter(f"{slot.name} {axis}", unit, prior, slot.role))
    numbers = [_device_scalars(cell, device, level, priors) for device in cell.devices]
    for device, scalars in zip(cell.devices, numbers, strict=True):
        for name, scalar in zip(SCALARS, scalars, strict=True):
            what, unit = _SCALAR_NAMES[name]
            prior = scalar.sigma if np.isfinite(scalar.sigma) else priors.place_m
            whole.append(Parameter(f"{device.name} {what}", unit, prior, "wire"))
    entries = []
    for robot, its_terms in zip(cell.robots, terms, strict=True):
        mark = f"{robot.name} " if len(cell.robots) > 1 else ""
        freed, geometry = geometry_parameters(robot.model, level, priors)
        fixed_terms = [
            replace(p, prior=0.0) for p in term_parameters(_earlier_terms(robot, its_terms), priors)
        ]
        entries.append(tuple(freed))
        whole += [
            replace(p, name=mark + p.name)
            for p in (*geometry, *term_parameters(its_terms, priors), *fixed_terms)
        ]
    means = np.array([[scalar.value for scalar in scalars] for scalars in numbers]).reshape(-1, 3)
    arms = tuple(_expected_arm(robot, its) for robot, its in zip(cell.robots, terms, strict=True))
    expected = CellState(arms, np.tile(np.eye(4), (len(frames.slots), 1, 1)), means)
    free = np.array([i for i, parameter in enumerate(whole) if parameter.prior > 0], dtype=np.intp)
    return CellLayout(frames, tuple(whole), free, tuple(entries), expected)


def _device_scalars(
    cell: CalibrationCell, device: CellDevice, level: int, priors: Priors
) -> list[DeviceScalar]:
    """Return expected value and deviation of every number of a device; what no row shows is fixed."""
    here = [s.observations for s in cell.series if s.device == device.name]
    shown = {name for observations in here for name in observations.scalars}
    wire = any(observations.kind in ("length", "guided length") for observations in here) and level > FRAMES
    usual = {
        "zero_m": DeviceScalar(0.0, priors.wire_zero_m if wire else 0.0),
        "scale": DeviceScalar(1.0, priors.wire_scale if wire else 0.0),
        "radius_m": DeviceScalar(0.0, 0.0),
    }
    expected = {name: device.scalars.get(name, usual[name]) for name in SCALARS}
    return [expected[name] if name in shown else DeviceScalar(expected[name].value, 0.0) for name in SCALARS]


def _earlier_terms(robot: CellRobot, terms: tuple[JointTerm, ...]) -> tuple[JointTerm, ...]:
    """Return the terms of an earlier fit that a level does not free: they stay as they were."""
    return () if robot.previous is None else tuple(t for t in robot.previous.terms if t not in terms)


def _expected_arm(robot: CellRobot, terms: tuple[JointTerm, ...]) -> ArmState:
    nominal = nominal_state(robot.model, ())
    earlier = robot.previous or nominal
    if earlier.geometry.shape != nominal.geometry.shape:
        raise CalibrationError(
            make_message("robot {name!r}: the earlier parameters belong to another model", name=robot.name)
        )
    terms = (*terms, *_earlier_terms(robot, terms))
    before = dict(zip(earlier.terms, earlier.coefficients.tolist(), strict=True))
    coefficients = np.array([before.get(term, 0.0) for term in terms])
    return replace(nominal, geometry=earlier.geometry, terms=terms, coefficients=coefficients)
