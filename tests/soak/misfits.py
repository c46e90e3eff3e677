"""Files of measurements that are wrong in one known way: is the cause named, whatever robot it is?"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel, load_model, model_names
from cellcal.calibration.geometry import Array, exp_twist, homogeneous_matrix
from cellcal.calibration.identification.misfit import refuse_misfit
from cellcal.calibration.identification.misfit_error import MisfitError
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.observations import DevicePlacement, PointObservations
from cellcal.calibration.identification.parameters import ArmState, nominal_state
from tests.soak.campaign_figures import CampaignFigures

SEEDS = 20
_REACH_RAD = 2.0
_ERRORS = np.array([np.deg2rad(0.15), 4e-4, 4e-4, np.deg2rad(0.03), np.deg2rad(0.03)])
_SIGMA_M = 1e-4
_LEAST_NAMED = 0.95
_INNER = (1, 2, 3, 4)  # joints whose zero neither the base nor the target hides


@dataclass(frozen=True, eq=False)
class SpoiltRows:
    """Rows as a file has them, and what the answer must say."""

    model: RobotModel  # as it was named
    rows: PointObservations
    kind: str
    says: tuple[str, ...]  # all of these words
    unit: str = "mm"


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Rows of a robot with its own errors, as they should be."""

    model: RobotModel
    rows: PointObservations
    rng: np.random.Generator

    def joint_names(self) -> tuple[str, ...]:
        """Return what the joints are called."""
        return self.model.joint_names

    def with_joints(self, joints_rad: Array) -> PointObservations:
        """Return the rows with other joints."""
        return replace(self.rows, joints_rad=joints_rad)

    def with_positions(self, positions_m: Array) -> PointObservations:
        """Return the rows with other positions."""
        return replace(self.rows, positions_m=positions_m)


def measure_rows(robot: str, seed: int) -> MeasuredRows:
    """Return 30 to 60 rows of a robot with errors of its own, a few of them far off."""
    model, rng = load_model(robot), np.random.default_rng([seed, *robot.encode()])
    device = exp_twist(np.concatenate([rng.uniform(-2, 2, 3), rng.uniform(-1.5, 1.5, 3)]))
    tool = homogeneous_matrix(
        np.eye(3),
        np.array([*(rng.choice([-1, 1], 2) * rng.uniform(0.03, 0.1, 2)), rng.uniform(0.05, 0.2)]),
    )
    start = nominal_state(model, (DevicePlacement(device, np.zeros(3)),), tool)
    geometry = rng.standard_normal((model.axis_count, 5)) * _ERRORS
    truth = ArmState(model, geometry, (), np.zeros(0), start.flange_tool, start.devices)
    low, high = np.maximum(model.lower_rad, -_REACH_RAD), np.minimum(model.upper_rad, _REACH_RAD)
    count = int(rng.integers(30, 61))
    joints = rng.uniform(low, high, (count, model.axis_count))
    positions_m = truth.seen_from(0).base_flange(joints)[:, :3, 3] + _SIGMA_M * rng.standard_normal(
        (count, 3)
    )
    wrong = rng.choice(count, count // 20, replace=False)
    positions_m[wrong] += 0.05 * rng.standard_normal((len(wrong), 3))
    rows = PointObservations(joints, positions_m, np.full(count, 3e-4), np.zeros(count, dtype=np.intp))
    return MeasuredRows(model, rows, rng)


def _mirror_axis(true: MeasuredRows) -> SpoiltRows:
    sign = np.ones(3)
    sign[true.rng.integers(3)] = -1.0
    return SpoiltRows(
        true.model, true.with_positions(true.rows.positions_m * sign), "mirror", ("mirror image",)
    )


def _swapped_columns(true: MeasuredRows) -> SpoiltRows:
    order = [[1, 0, 2], [0, 2, 1], [2, 1, 0]][true.rng.integers(3)]
    return SpoiltRows(
        true.model, true.with_positions(true.rows.positions_m[:, order]), "mirror", ("swapped",)
    )


def _flip_joint_sign(true: MeasuredRows) -> SpoiltRows:
    joint, sign = int(true.rng.integers(true.model.axis_count)), np.ones(true.model.axis_count)
    sign[joint] = -1.0
    rows = true.with_joints(true.rows.joints_rad * sign)
    return SpoiltRows(true.model, rows, "sign", (f"{true.joint_names()[joint]} counts the other way",))


def _shift_home(true: MeasuredRows, angle_deg: float) -> SpoiltRows:
    joint, zero = int(true.rng.choice(_INNER)), np.zeros(true.model.axis_count)
    zero[joint] = np.deg2rad(angle_deg)
    rows = true.with_joints(true.rows.joints_rad - zero)
    return SpoiltRows(true.model, rows, "home", (f"that of {true.joint_names()[joint]} by {angle_deg:+.0f}",))


def _quarter_home(true: MeasuredRows) -> SpoiltRows:
    return _shift_home(true, float(true.rng.choice([-90.0, 90.0])))


def _free_home(true: MeasuredRows) -> SpoiltRows:
    found = _shift_home(true, float(true.rng.choice([-1, 1]) * true.rng.integers(8, 80)))
    return replace(found, says=(found.says[0].rpartition("by")[0],))


def _swap_joints(true: MeasuredRows) -> SpoiltRows:
    a, b = true.rng.choice(true.model.axis_count, 2, replace=False)
    order = np.arange(true.model.axis_count)
    order[[a, b]] = order[[b, a]]
    columns = ", ".join(true.joint_names()[i] for i in order)
    return SpoiltRows(true.model, true.with_joints(true.rows.joints_rad[:, order]), "order", (columns,))


def _add_coupling(true: MeasuredRows) -> SpoiltRows:
    coupling, joints = true.model.joint_coupling, true.rows.joints_rad
    if abs(coupling[2, 1]) > 0:
        sign = np.sign(np.diag(coupling))
        return SpoiltRows(true.model, true.with_joints((coupling @ joints.T).T * sign), "coupling", ())
    changed = joints.copy()
    changed[:, 2] += joints[:, 1] * float(true.rng.choice([-1.0, 1.0]))
    return SpoiltRows(true.model, true.with_joints(changed), "coupling", ())


def _angle_unit(true: MeasuredRows) -> SpoiltRows:
    factor, unit = ((180 / np.pi, "deg"), (np.pi / 180, "rad"))[true.rng.integers(2)]
    return SpoiltRows(
        true.model, true.with_joints(true.rows.joints_rad * factor), "angle unit", (f"in {unit}",)
    )


def _scale_to_metres(true: MeasuredRows) -> SpoiltRows:
    factor, taken, unit = ((1e3, "m", "mm"), (1e-3, "mm", "m"), (10.0, "cm", "mm"))[true.rng.integers(3)]
    rows = true.with_positions(true.rows.positions_m * factor)
    return SpoiltRows(true.model, rows, "unit", (f"in {unit}, not in {taken}",), taken)


def _scale_to_inches(true: MeasuredRows) -> SpoiltRows:
    metres, taken = ((1e-3, "mm"), (1e-2, "cm"), (1.0, "m"))[true.rng.integers(3)]
    rows = true.with_positions(true.rows.positions_m / 0.0254 * metres)
    return SpoiltRows(true.model, rows, "unit", (f"in inch, not in {taken}",), taken)


def _other_model(true: MeasuredRows) -> SpoiltRows:
    others = [name for name in model_names() if name != true.model.name]
    named = load_model(str(true.rng.choice(others)))
    return SpoiltRows(named, true.rows, "model", (f"this is a {true.model.name}",))


def _rows_apart(true: MeasuredRows) -> SpoiltRows:
    shift = int(true.rng.choice([-2, -1, 1, 2]))
    joints = np.roll(true.rows.joints_rad, shift, axis=0)
    return SpoiltRows(true.model, true.with_joints(joints), "rows", (f"{abs(shift)} row",))


WAYS: Mapping[str, Callable[[MeasuredRows], SpoiltRows]] = {
    "mirror": _mirror_axis,
    "swapped columns": _swapped_columns,
    "sign": _flip_joint_sign,
    "quarter home": _quarter_home,
    "free home": _free_home,
    "order": _swap_joints,
    "coupling": _add_coupling,
    "angle unit": _angle_unit,
    "metres": _scale_to_metres,
    "inches": _scale_to_inches,
    "other model": _other_model,
    "rows apart": _rows_apart,
}


def answer_to(spoilt: SpoiltRows) -> MisfitError | None:
    """Return the refusal of spoilt rows."""
    names = FileNames(spoilt.model.joint_names, length_unit=spoilt.unit, angle_unit="")
    try:
        refuse_misfit(spoilt.model, spoilt.rows, names)
    except MisfitError as refused:
        return refused
    return None


def is_named(spoilt: SpoiltRows, refused: MisfitError | None) -> bool:
    """Tell whether the first cause of a refusal is the right one."""
    if refused is None or not refused.causes:
        return False
    first = refused.causes[0]
    return first.kinds == (spoilt.kind,) and all(words in first.says for words in spoilt.says)


def misfits(seeds: int) -> CampaignFigures:
    """Twelve ways to spoil a file, every robot that ships, so many seeds: the cause is named, and nothing passes."""
    named = dict.fromkeys(WAYS, 0)
    passed = tried = false_alarms = 0
    for robot in model_names():
        for seed in range(seeds):
            true = measure_rows(robot, seed)
            false_alarms += answer_to(SpoiltRows(true.model, true.rows, "", ())) is not None
            for way, spoil in WAYS.items():
                spoilt = spoil(measure_rows(robot, seed))
                refused = answer_to(spoilt)
                named[way] += is_named(spoilt, refused)
                passed += refused is None
                tried += 1
    each = seeds * len(model_names())
    parts = ", ".join(f"{way} {count}/{each}" for way, count in named.items())
    share = sum(named.values()) / tried
    line = (
        f"misfits: {share:.1%} of {tried} spoilt files have their cause named first ({parts}); "
        f"{passed} not refused, {false_alarms} of {each} good ones refused"
    )
    return CampaignFigures(line, share >= _LEAST_NAMED and not false_alarms)
