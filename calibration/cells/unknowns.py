"""What the series of a cell cannot determine, what it hides behind, and what would bring it out."""

import numpy as np

from cellcal.calibration.cells.estimate import CellFit
from cellcal.calibration.cells.state import CellFrames, CellState, FrameRoute, FrameSlot
from cellcal.calibration.geometry import Array, adjoint_matrix, inverse_transform
from cellcal.calibration.identification.identifiability import (
    NotIdentified,
    acts_in_a_sum,
    hiding_partners,
)
from cellcal.calibration.identification.parameters import Parameter
from cellcal.calibration.message import join_messages, make_message

_LEARNED = 0.5  # of the prior deviation: above, the value comes from the prior rather than from the data
_FOUND_M, _FOUND_RAD = 0.05, 0.05  # an unknown place that stays vaguer than this has not been found
_ARM_ROLES = ("offset", "geometry", "wire", "gravity", "gear")
_PLACE_ROLES = ("base", "tool", "target", "device")
_TURNS = 0.1  # rad per rad or per m: below, a frame moves along rather than around
_ALONG = 0.99
_FIXED_PLACE_CURE = "record a point in the base frame, or measure the device's place from the base"
_TOOL_CURE = "use a target off the last axis whose place on the flange is known"
_ROWS_CURE = "measure more rows that show it, or give the place with its deviation"
_WIRE_CURE = "check zero, scale and radius of the device against a known length"
_NO_CURE = "none needed while they act together: only their sum moves the target in these postures"
_TARGETS_CURE = "measure three targets of the tool, not on one line, whose places in it are known"


def find_not_identified(fit: CellFit) -> tuple[NotIdentified, ...]:
    """Return every parameter that the series leave where its prior put it, and every frame they do not find.

    A place that was given with a deviation may stay at it: that is what it was given for.
    """
    sigma = np.sqrt(np.diag(fit.covariance))
    learnt = sigma / fit.layout.prior_sigmas
    found = []
    for number, parameter in enumerate(fit.layout.parameters):
        weak = parameter.role in _ARM_ROLES and learnt[number] > _LEARNED
        if weak or _is_undetermined(fit, number, float(sigma[number])):
            found.append(_describe_unknown(fit, number, float(learnt[number])))
    return tuple(found)


def _is_undetermined(fit: CellFit, number: int, sigma: float) -> bool:
    parameter = fit.layout.parameters[number]
    if parameter.role not in _PLACE_ROLES:
        return False
    slot, axis = divmod(int(fit.layout.free[number]), 6)
    unknown = np.isinf(fit.layout.frames.slots[slot].place.sigma[axis])
    return bool(unknown) and sigma > (_FOUND_RAD if parameter.unit == "rad" else _FOUND_M)


def _describe_unknown(fit: CellFit, own: int, ratio: float) -> NotIdentified:
    parameters = fit.layout.parameters
    blocks, share = hiding_partners(fit, own, _block_name)
    words = join_messages(", ", [_describe_partner(fit, own, block) for block in blocks])
    cure = _suggest_measurement(parameters[own], [parameters[block[0]] for block in blocks])
    return NotIdentified(parameters[own].name, words, cure, ratio, share)


def _block_name(parameter: Parameter) -> str:
    if parameter.role in _PLACE_ROLES:
        return parameter.name.rsplit(" ", 1)[0]
    return parameter.name


def _describe_partner(fit: CellFit, own: int, block: list[int]) -> str:
    """Return how a partner moves when the parameter does, in axes that people know."""
    first = fit.layout.parameters[block[0]]
    if first.role not in _PLACE_ROLES:
        return first.name
    number = int(fit.layout.free[block[0]]) // 6
    slot = fit.layout.frames.slots[number]
    twist = np.zeros(6)
    axes = [int(fit.layout.free[i]) % 6 for i in block]
    twist[axes] = fit.covariance[block, own] / fit.covariance[own, own]
    frame, outer = _known_axes(fit.layout.frames, fit.state, slot, number)
    twist = adjoint_matrix(frame) @ twist
    turning, sliding = np.linalg.norm(twist[3:]), np.linalg.norm(twist[:3])
    if max(axes) >= 3 and turning > _TURNS:
        return make_message(
            "rotation of {frame} about {axis} of {outer}",
            frame=_slot_text(slot),
            axis=_axis_text(twist[3:]),
            outer=outer,
        )
    if sliding > 0 and max(axes) < 3:
        return make_message(
            "place of {frame} ({axis} of {outer})",
            frame=_slot_text(slot),
            axis=_axis_text(twist[:3]),
            outer=outer,
        )
    return make_message("place of {frame}", frame=_slot_text(slot))


def _slot_text(slot: FrameSlot) -> str:
    if slot.role in ("base", "tool"):
        return make_message("the {name}", name=slot.name)
    return make_message("device {name!r}", name=slot.name) if slot.role == "device" else slot.name


def _known_axes(frames: CellFrames, state: CellState, slot: FrameSlot, number: int) -> tuple[Array, str]:
    """Return a slot seen from the frame in which people know its motions: the base that it sees, or its parent."""
    if slot.role in ("tool", "target"):
        return state.places[number], "the flange" if slot.role == "tool" else "the tool"
    route = _route_of(frames, number)
    base = inverse_transform(state.places[route.base])
    robot = frames.slots[route.base].name
    return base @ state.places[number], make_message("the {name}", name=robot) if len(
        state.arms
    ) > 1 else "the base"


def _route_of(frames: CellFrames, number: int) -> FrameRoute:
    for series in frames.cell.series:
        for mounting in range(len(frames.cell.find_device(series.device).places)):
            route = frames.find_route(series.target, series.device, mounting)
            if number in (route.device, route.base):
                return route
    return frames.find_route(frames.cell.series[0].target)


def _axis_text(vector: Array) -> str:
    unit = vector / np.linalg.norm(vector)
    largest = int(np.argmax(np.abs(unit)))
    if abs(unit[largest]) > _ALONG:
        return "xyz"[largest]
    return "(" + ", ".join(f"{part:.2f}" for part in unit) + ")"


def _suggest_measurement(parameter: Parameter, hiding: list[Parameter]) -> str:
    """Return what to measure: the first of these that applies."""
    partner_roles = {partner.role for partner in hiding}
    # Where axes are not parallel, an offset and the same row's beta do the same.
    one_row = bool(hiding) and {partner.joint for partner in hiding} == {parameter.joint}
    own, alone = parameter.role, not partner_roles & set(_ARM_ROLES)
    joint = f"J{parameter.joint + 1}" if parameter.joint >= 0 else "the arm"
    cures = (
        (own in ("tool", "target") and parameter.unit == "rad", _TARGETS_CURE),
        (own == "wire", _WIRE_CURE),
        (own in _PLACE_ROLES and alone, _ROWS_CURE),
        (acts_in_a_sum(hiding), _NO_CURE),
        (bool(partner_roles & {"base", "device"}), _FIXED_PLACE_CURE),
        (bool(partner_roles & {"tool", "target"}), _TOOL_CURE),
        ("wire" in partner_roles, _WIRE_CURE),
        (partner_roles == {"geometry"} or one_row, _NO_CURE),
        (
            True,
            make_message(
                "measure postures that turn {joint} and its neighbours further, with the tool in other attitudes",
                joint=joint,
            ),
        ),
    )
    return next(cure for applies, cure in cures if applies)
