"""The columns and residuals of observations at a state of the arm: what each motion does to each reading."""

from collections.abc import Iterator
from math import prod
from threading import local

import numpy as np

from cellcal.calibration.arm.kinematics import (
    frames_of_placements,
    independent_columns,
    twists_by_independent_columns,
)
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.fit_problem import FitProblem, Span, places_in_span, rows_of_span
from cellcal.calibration.identification.observations import DevicePlacement, Rows, join_gauges
from cellcal.calibration.identification.parameters import ArmState, ParameterLayout


class _Workspace(local):
    """Arrays that are written again block after block, kept by each thread between fits.

    Touching memory that is new from the system costs more than the arithmetic on it. What is taken under a name
    is good until the next one takes it.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Array] = {}

    def get_array(self, name: str, *shape: int) -> Array:
        """Return an array of this shape, with anything in it."""
        size = prod(shape)
        if name not in self._arrays or self._arrays[name].size < size:
            self._arrays[name] = np.empty(size)
        return self._arrays[name][:size].reshape(shape)


_WORKSPACE = _Workspace()


class ArmChains:
    """The arm between device and target at one state, for all mountings: what they share is made once."""

    def __init__(self, state: ArmState) -> None:
        self.state = state
        self._placements: dict[int, Array] = {}
        self._combine: dict[int, Array] = {}  # by target

    def placements_of(self, mounting: int) -> Array:
        """Return those of `ArmState.seen_from` (n + 1, 4, 4), without a model around them."""
        if mounting not in self._placements:
            state, placements = self.state, self.state.arm_model.placements.copy()
            placements[0] = state.device_of(mounting).device_base @ placements[0]
            placements[-1] = placements[-1] @ state.target_of(mounting)
            self._placements[mounting] = placements
        return self._placements[mounting]

    def combine_of(self, mounting: int, kind: str) -> Array:
        """Return every twist of a placement by the system's columns: the same before any device."""
        target = mounting if self.state.further else 0
        if target not in self._combine:
            combine = twists_by_independent_columns(self.placements_of(target))
            self._combine[target] = combine if kind == "pose" else combine[:, :-3]
        return self._combine[target]

    def turns_of(self, mounting: int, kind: str) -> Array:
        """Return what each joint term's joint does, by independent columns (K, P)."""
        joints = np.array([term.joint for term in self.state.terms], dtype=np.intp)
        turns: Array = self.combine_of(mounting, kind)[6 * joints + self.state.nominal.joint_twists[joints]]
        return turns

    def column_count(self, problem: FitProblem) -> int:
        """Return how many columns the system of a problem has: of the arm, of joint terms, of the device."""
        observations = problem.observations
        arm: int = self.combine_of(0, observations.kind).shape[1]
        return arm + len(self.state.terms) + observations.device_columns

    def tangent_of(self, layout: ParameterLayout, mounting: int) -> Array:
        """Return (p, P + K + D): what each parameter does, by columns of the system."""
        combine = self.combine_of(mounting, layout.kind)
        tangent = layout.tangent_rows(self.state, mounting)
        arm, rest = tangent[:, : len(combine)], tangent[:, len(combine) :]
        return np.concatenate([arm @ combine, rest], axis=1)


def span_frames(chains: ArmChains, problem: FitProblem, span: Span) -> tuple[Array, Array]:
    """Return the frames of `chain_frames` of the rows of a span, each seen from its own mounting's device."""
    state, rows = chains.state, rows_of_span(span)
    angles = problem.angles_rad[:, rows] + state.arm_model.theta0_rad[:, None]
    values = problem.term_values_of(rows)
    for term, coefficient, value in zip(state.terms, state.coefficients, values, strict=True):
        angles[term.joint] += coefficient * value
    placements = chains.placements_of(span[0][0])
    out = _WORKSPACE.get_array("frames", len(placements), 4, 3, angles.shape[1])
    starts = None
    if len(span) > 1 and problem.observations.kind != "length":
        places = zip(span, places_in_span(span), strict=True)
        starts = [(here, chains.placements_of(mounting)[0]) for (mounting, _), here in places]
    return frames_of_placements(placements, angles, out=out, sliding=state.nominal.sliding, starts=starts)


def devices_of_span(
    state: ArmState, problem: FitProblem, span: Span
) -> Iterator[tuple[DevicePlacement, Rows | slice, slice]]:
    """Yield the devices that saw rows of a span, these rows, and where they are in it; mountings as one if may be."""
    places = list(places_in_span(span))
    devices = [state.device_of(mounting) for mounting, _ in span]
    if len(span) > 1 and problem.observations.kind == "length":
        gauge = join_gauges(devices, [here.stop - here.start for here in places])
        if gauge is not None:
            yield gauge, rows_of_span(span), slice(0, places[-1].stop)
            return
    for device, (_, rows), here in zip(devices, span, places, strict=True):
        yield device, rows, here


def whitened_system(chains: ArmChains, problem: FitProblem, span: Span) -> Array:
    """Return the whitened columns of a span and, in the last row, its residuals (P + K + D + 1, channels, N)."""
    observations, state, rows = problem.observations, chains.state, rows_of_span(span)
    values, turns = problem.term_values_of(rows), chains.turns_of(span[0][0], observations.kind)
    count = turns.shape[1]
    rotations, origins = span_frames(chains, problem, span)
    size, rows_taken = chains.column_count(problem) + 1, origins.shape[-1]
    system = _WORKSPACE.get_array("system", size, observations.channels, rows_taken)
    scales, columns = problem.channel_scales(rows), system[:count]
    linear, angular = columns, None
    if observations.channels == 3:  # the tip's motion is the answer, in place
        independent_columns(rotations, origins, out=columns, scale=scales[0])
    else:
        linear = independent_columns(
            rotations, origins, out=_WORKSPACE.get_array("linear", count, 3, rows_taken)
        )
        angular = _angular_columns(rotations) if observations.needs_rotation else None
    own = system[count + len(state.terms) : -1]
    for device, mounted_rows, here in devices_of_span(state, problem, span):
        tip = origins[-1][:, here], rotations[-1][..., here]
        if observations.channels != 3:
            turned = None if angular is None else angular[..., here]
            moved = observations.project_motions(linear[..., here], turned, tip, device)
            np.multiply(moved, scales[:, here], out=columns[..., here])
        np.multiply(observations.own_columns(tip, device), scales[:, here], out=own[..., here])
        system[-1][:, here] = observations.compute_residuals(tip, device, mounted_rows)
    if state.terms:
        moved = (turns @ columns.reshape(count, -1)).reshape(-1, *system.shape[1:])
        np.multiply(moved, values[:, None], out=system[count : count + len(moved)])
    if problem.root is not None:
        system[-1] *= problem.root[rows]
    return system


def _angular_columns(rotations: Array) -> Array:
    """Return (4 n + 6, 3, N): how the motions of `independent_columns` turn the tip."""
    n, count = len(rotations) - 1, rotations.shape[-1]
    columns = np.zeros((4 * n + 6, 3, count))
    columns[: 4 * n].reshape(n, 4, 3, count)[:, 2:] = rotations[:-1].swapaxes(1, 2)[:, :2]
    columns[-3:] = rotations[-1].swapaxes(0, 1)
    return columns
