"""Predictions of a fitted cell for points and frames that were not measured, with their uncertainty."""

from dataclasses import dataclass

import numpy as np

from cellcal.calibration.cells.estimate import CellFit
from cellcal.calibration.cells.state import NOWHERE, CellLayout, CellState, FrameRoute
from cellcal.calibration.cells.system import PreparedPostures, RouteChain
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array, adjoint_matrix, inverse_transform
from cellcal.calibration.message import make_message

WORLD = ""


@dataclass(frozen=True, eq=False)
class FoundFrame:
    """A frame seen from another, with the covariance of a small motion in its own axes."""

    pose: Array  # (4, 4)
    covariance: Array  # (6, 6): x y z [m], rx ry rz [rad]

    @property
    def sigma(self) -> Array:
        """Standard deviations along and about the frame's own axes (6,)."""
        return np.sqrt(np.diag(self.covariance))


def target_positions(fit: CellFit, target: str, joints_rad: Array, *, seen_from: str | None = None) -> Array:
    """Return where a target or tool is (N, 3) [m]; ``seen_from`` as in `tip_covariance`."""
    chain = _target_chain(fit.layout, fit.state, target, seen_from)
    postures = PreparedPostures.from_joints(chain.along.arm, np.asarray(joints_rad, dtype=float))
    positions: Array = chain.compute_frames(postures, np.arange(len(joints_rad)))[1][-1].T
    return positions


def tip_covariance(fit: CellFit, target: str, joints_rad: Array, *, seen_from: str | None = None) -> Array:
    """Return the covariance of a target's predicted position at any postures.

    Parameters
    ----------
    fit : CellFit
        With the covariance of all unknowns.
    target : str
        A target or tool of the cell.
    joints_rad : (N, n)
        Postures of its robot [rad].
    seen_from : str or None
        None: the base of the target's robot. "": the world. Otherwise a device, at its first place.

    Returns
    -------
    (N, 3, 3)
        In the axes of the frame it is seen from [m^2].

    Raises
    ------
    CalibrationError
        No such target or device, or joints of another shape.

    Notes
    -----
    First order: ``J S J'``. Parameters that no series observes enter with their prior: a base whose rotation
    about J1 was not recorded makes positions in the base uncertain, and those in the device's frame not.
    """
    joints = np.asarray(joints_rad, dtype=float)
    chain = _target_chain(fit.layout, fit.state, target, seen_from)
    if (
        joints.ndim != 2
        or joints.shape[1] != chain.along.arm.nominal.axis_count
        or not np.isfinite(joints).all()
    ):
        raise CalibrationError(
            make_message(
                "joints must be finite and (N, {axis_count}), not {shape}",
                axis_count=chain.along.arm.nominal.axis_count,
                shape=joints.shape,
            )
        )
    _, linear, _ = chain.motion_columns(
        PreparedPostures.from_joints(chain.along.arm, joints), np.arange(len(joints)), turning=False
    )
    columns = np.tensordot(chain.tangent, linear, axes=1)  # (p, 3, N)
    spread = np.tensordot(fit.covariance, columns, axes=1)
    covariance: Array = np.einsum("pcn,pdn->ncd", columns, spread)
    return covariance


def frame_between(fit: CellFit, outer: str, inner: str, *, mounting: int = 0) -> FoundFrame:
    """Return one frame of the world seen from another: robots by name, devices by name, "" for the world.

    ``mounting`` counts the places of an inner device that was moved. The base of one robot in the base of another
    is the transformation for programs that share a fixture.

    Raises
    ------
    CalibrationError
        No robot or device has such a name.
    """
    layout, places = fit.layout, fit.state.places
    numbers = [_slot_number(layout, outer), _slot_number(layout, inner) + mounting]
    first, second = (np.eye(4) if number == NOWHERE else places[number] for number in numbers)
    pose = inverse_transform(first) @ second
    follows = np.zeros((6, len(layout.whole)))
    if numbers[0] != NOWHERE:
        follows[:, 6 * numbers[0] : 6 * numbers[0] + 6] -= adjoint_matrix(inverse_transform(pose))
    if numbers[1] != NOWHERE:
        follows[:, 6 * numbers[1] : 6 * numbers[1] + 6] += np.eye(6)
    follows = follows[:, layout.free]
    return FoundFrame(pose, follows @ fit.covariance @ follows.T)


def tool_in_flange(fit: CellFit, tool: str) -> FoundFrame:
    """Return a tool in its robot's flange; of a tool that is a point, the turning is not asked for.

    Raises
    ------
    CalibrationError
        No tool has such a name.
    """
    if ("tool", tool) not in fit.layout.frames.names:
        raise CalibrationError(make_message("the cell has no tool {tool!r}.", tool=tool))
    number = fit.layout.frames.names["tool", tool]
    follows = np.eye(len(fit.layout.whole))[6 * number : 6 * number + 6, fit.layout.free]
    return FoundFrame(fit.state.places[number], follows @ fit.covariance @ follows.T)


def _slot_number(layout: CellLayout, name: str) -> int:
    if name == WORLD:
        return NOWHERE
    for role in ("base", "device"):
        if (role, name) in layout.frames.names:
            return layout.frames.names[role, name]
    raise CalibrationError(
        make_message("the cell has no robot and no device {name!r}.", name=name),
        remedy=make_message(
            "It has {names}.",
            names=", ".join(sorted((repr(n) for r, n in layout.frames.names if r in ("base", "device")))),
        ),
    )


def _target_chain(layout: CellLayout, state: CellState, target: str, seen_from: str | None) -> RouteChain:
    target_names = [key[1] for key in layout.frames.names if key[0] in ("tool", "target")]
    if target not in target_names:
        raise CalibrationError(
            make_message("the cell has no target {target!r}.", target=target),
            remedy=make_message("It has {names}.", names=", ".join(target_names)),
        )
    route = layout.frames.find_route(target)
    viewpoint = route.base if seen_from is None else _slot_number(layout, seen_from)
    route = FrameRoute(route.arm, route.base, route.tool, route.target, viewpoint)
    return RouteChain.along_route(layout, state, route, NOWHERE, ())
