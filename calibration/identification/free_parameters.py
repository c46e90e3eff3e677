"""Which parameters a fit may move, and where it starts: all of a level from nominal, or any subset from before.

What is not free is held where it was. Priors then stand around the values of before: an arm that was identified
once is expected to be that arm still.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cellcal.calibration.arm.joint_terms import (
    JointTerm,
    gear_terms,
    gravity_terms,
    harmonic_terms,
    wrist_gravity_terms,
)
from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.layouts import make_layout, with_further
from cellcal.calibration.identification.observations import DevicePlacement, Rows
from cellcal.calibration.identification.parameters import (
    FRAMES,
    GEAR,
    GEOMETRY,
    GRAVITY,
    OFFSETS,
    RIPPLE,
    ArmState,
    Parameter,
    ParameterLayout,
    Priors,
)
from cellcal.calibration.message import make_message

# To the eighth: the same orders predict another series of one arm better, higher ones only the series they are from.
RIPPLE_ORDERS = tuple(range(1, 9))
PLACE_ROLES = ("base", "anchor", "tool")
GROUPS = {
    "offsets": ("offset",),
    "geometry": ("geometry",),
    "gravity": ("gravity",),
    "ripple": ("harmonic",),
    "gear": ("gear",),
    "wire": ("wire",),
    "base": ("base", "anchor"),
    "tool": ("tool",),
}
_LEVEL_OF_ROLE = {
    "wire": OFFSETS,
    "offset": OFFSETS,
    "geometry": GEOMETRY,
    "gravity": GRAVITY,
    "harmonic": RIPPLE,
    "gear": GEAR,
}


@dataclass(frozen=True, eq=False)
class KnownPlaces:
    """The known places of a device and of the target on the flange."""

    device: DevicePlacement
    flange_tool: Array  # (4, 4)


@dataclass(frozen=True, eq=False)
class StartingPoint:
    """Parameters known before a fit, and which of them it may change."""

    values: Mapping[str, float] = field(default_factory=dict)  # by parameter's name, SI, off nominal
    free: tuple[str, ...] = ()  # names and groups; none: everything of a level
    places: KnownPlaces | None = None  # without them base and tool are always free
    names: tuple[str, ...] = ()  # of parameters whose covariance an earlier fit left
    covariance: Array | None = None  # (k, k) of these

    @property
    def is_nominal(self) -> bool:
        """Whether there is nothing to know."""
        return not (self.values or self.free)

    @property
    def holds_places(self) -> bool:
        """Whether base, tool or both are held, so that nothing is placed anew and no device has moved."""
        return self.places is not None and bool(self.free) and not {"base", "tool"} <= set(self.free)

    def is_freed(self, parameter: Parameter) -> bool:
        """Return whether a fit may move a parameter."""
        if not self.free or (self.places is None and parameter.role in PLACE_ROLES):
            return True
        return any(_word_names(word, parameter) for word in self.free)

    def rigid_arm(self, model: RobotModel) -> RobotModel:
        """Return the rigid arm as it was known before."""
        return starting_state(model, self, (), np.eye(4), ()).arm_model


def _word_names(word: str, parameter: Parameter) -> bool:
    if word in GROUPS:
        return parameter.role in GROUPS[word]
    rigid = parameter.role in ("offset", "geometry")
    return word == parameter.name or (rigid and word == f"J{parameter.joint + 1}")


def normalise_words(words: Iterable[str], parameters: Sequence[Parameter]) -> tuple[str, ...]:
    """Return names and groups as they are written here, whatever their case.

    Raises
    ------
    CalibrationError
        A word that is neither, with all that could be meant.
    """
    joints = sorted({f"J{p.joint + 1}" for p in parameters if p.joint >= 0})
    groups = [g for g, roles in GROUPS.items() if any(p.role in roles for p in parameters)]
    names_by_lower = {word.lower(): word for word in (*groups, *joints, *(p.name for p in parameters))}
    cleaned = [" ".join(word.split()) for word in words]
    wrong = [word for word in cleaned if word.lower() not in names_by_lower]
    if wrong:
        names = [p.name for p in parameters if p.role not in ("harmonic", *PLACE_ROLES)]
        raise CalibrationError(
            make_message("there is no parameter {wrong!r}.", wrong=wrong[0]),
            remedy=make_message(
                "Groups: {groups_text}. Joints: {joints_text}. Parameters: {names_text}.",
                groups_text=", ".join(groups),
                joints_text=", ".join(joints),
                names_text=", ".join(names),
            ),
            code="usage",
        )
    return tuple(names_by_lower[word.lower()] for word in cleaned)


def level_of(start: StartingPoint, parameters: Sequence[Parameter]) -> int:
    """Return the lowest level that has every parameter named as free."""
    roles = {p.role for p in parameters if p.role not in PLACE_ROLES and start.is_freed(p)}
    return max((_LEVEL_OF_ROLE[role] for role in roles), default=FRAMES)


def all_joint_terms(model: RobotModel) -> tuple[JointTerm, ...]:
    """Return every joint term that an identification of this arm may hold."""
    sag = (*gravity_terms(model), *wrist_gravity_terms(model))
    return (*sag, *harmonic_terms(model, RIPPLE_ORDERS), *gear_terms(model))


def starting_state(
    model: RobotModel,
    start: StartingPoint,
    devices: tuple[DevicePlacement, ...],
    flange_tool: Array,
    terms: tuple[JointTerm, ...],
) -> ArmState:
    """Return the arm as it was known before, with at least these terms.

    Raises
    ------
    CalibrationError
        A value that this model has no place for.
    """
    whole = make_layout(model, "point", 1, level=GEOMETRY)
    names = [p.name for p in whole.parameters if p.role in ("offset", "geometry")]
    entries = dict(zip(names, whole.geometry, strict=True))
    geometry = np.zeros((model.axis_count, 5) if model.dh is not None else (model.axis_count + 1, 6))
    rest = {name: value for name, value in start.values.items() if name not in entries}
    for name in start.values.keys() & entries.keys():
        geometry[entries[name]] = start.values[name]
    if rest:
        own = {term.name for term in terms}
        others = {term.name: term for term in all_joint_terms(model)}
        unknown_names = sorted(rest.keys() - others.keys())
        if unknown_names:
            raise CalibrationError(
                make_message(
                    "{label} has no parameter {unknown_name!r}.",
                    label=model.label,
                    unknown_name=unknown_names[0],
                ),
                remedy="Start from a set of the same model.",
            )
        terms = (*terms, *(others[name] for name in rest if name not in own))
    coefficients = np.array([rest.get(term.name, 0.0) for term in terms], dtype=float)
    return ArmState(model, geometry, terms, coefficients, flange_tool, devices)


@dataclass(frozen=True, eq=False)
class PartLayout(ParameterLayout):
    """Some parameters of a whole layout, with priors around given values; the others are held."""

    whole: ParameterLayout
    free: Rows  # of the whole's parameters
    means: Array  # (p,)

    def prior_deviations(self, state: ArmState) -> Array:
        """Return how far each free parameter is from its prior mean (p,)."""
        deviations: Array = self.whole.prior_deviations(state)[self.free] - self.means
        return deviations

    def tangent_rows(self, state: ArmState, mounting: int) -> Array:
        """Return the rows of the whole tangent that belong to free parameters."""
        rows: Array = self.whole.tangent_rows(state, mounting)[self.free]
        return rows

    def apply_step(self, state: ArmState, change: Array) -> ArmState:
        """Return the state after a step of the free parameters (p,)."""
        every = np.zeros(len(self.whole))
        every[self.free] = change
        return self.whole.apply_step(state, every)


def prepare_fit(
    layout: ParameterLayout,
    terms: tuple[JointTerm, ...],
    model: RobotModel,
    places: ArmState,
    start: StartingPoint,
    priors: Priors,
) -> tuple[ParameterLayout, ArmState]:
    """Return the free ones of a level's unknowns, and the state at which their fit starts.

    ``places`` tells where devices and tool are; its arm does not matter.
    """
    start_state = starting_state(model, start, places.devices, places.flange_tool, terms)
    state = replace(start_state, further=places.further)
    if start.is_nominal:
        return layout, state
    count = len(places.devices)
    whole = make_layout(model, layout.kind, count, level=GEOMETRY, terms=state.terms, priors=priors)
    whole = with_further(whole, layout.further, priors)
    names = {p.name for p in layout.parameters}
    free = [i for i, p in enumerate(whole.parameters) if p.name in names and start.is_freed(p)]
    return _select_parameters(whole, np.array(free, dtype=np.intp), state), state


def _select_parameters(whole: ParameterLayout, free: Rows, state: ArmState) -> PartLayout:
    return PartLayout(
        tuple(whole.parameters[i] for i in free),
        whole.kind,
        whole.mountings,
        whole.geometry,
        whole.terms,
        further=whole.further,
        whole=whole,
        free=free,
        means=whole.prior_deviations(state)[free],
    )


def parameter_values(layout: ParameterLayout, state: ArmState) -> Array:
    """Return the values of a layout's parameters off nominal (p,); places have none, so zero."""
    if isinstance(layout, PartLayout):
        values: Array = layout.whole.prior_deviations(state)[layout.free]
        return values
    return layout.prior_deviations(state)
