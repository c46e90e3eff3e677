"""Joints that a file counts together with others: against the horizon or the base, or a slide that a joint screws."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel, chain_frames
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.misfit_hypotheses import FileNames, JointInterpretation, join_words
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.quick_fit import refine_number, trimmed_joint_scores
from cellcal.calibration.message import join_messages, make_message

_PARALLEL = 1e-3
_WIDEST_PITCH_M = 0.06  # a turn
_PITCH_STEPS_M = (1e-3, 1e-4, 1e-5)
_LEAST_PITCH_M = 1e-3
_TURN_RAD = 2 * np.pi


def coupled_readings(model: RobotModel, joints_rad: Array, names: FileNames) -> Iterator[JointInterpretation]:
    """Return joints with some counted against a link before that of the model, or no longer: both directions."""
    coupling, runs = model.joint_coupling, parallel_runs(model)
    is_plain = bool(np.allclose(coupling, np.diag(np.diag(coupling))))
    if not is_plain:
        yield from _controller_readings(model, joints_rad, names)
    pairs = [pair for run in runs for pair in itertools.pairwise(run)]
    if model.axis_count > 2 and _turning(model)[1:3].all():
        pairs.append((1, 2))
    for second, third in dict.fromkeys(pairs):
        yield from pair_readings(joints_rad, names, second, third)
    if is_plain:
        for run in runs:
            yield from _absolute_readings(model, joints_rad, names, run)


def model_readings(
    joints_rad: Array, names: FileNames, others: Sequence[RobotModel]
) -> Iterator[JointInterpretation]:
    """Return the same joints as those of other robots, as a controller counts them and against the link before."""
    for other in others:
        if other.axis_count != joints_rad.shape[1] or other.sliding is not None:
            continue
        says, cure = (
            make_message("this is a {other_name}", other_name=other.name),
            make_message("Name the robot that was measured: `--robot {other_name}`.", other_name=other.name),
        )
        yield JointInterpretation("model", 1, joints_rad, says, cure, model=other)
        for each in coupled_readings(other, joints_rad, names):
            yield JointInterpretation(
                "model",
                2,
                each.joints_rad,
                make_message("{says}, and {and_says}", says=says, and_says=each.says),
                join_messages(" ", (cure, each.cure)),
                model=other,
            )


def parallel_runs(model: RobotModel) -> list[tuple[int, ...]]:
    """Return joints that turn one after the other about parallel axes, two or more; slides between do not count."""
    axes = _axes_at_zero(model)
    runs: list[list[int]] = []
    for joint in np.flatnonzero(_turning(model)).tolist():
        if runs and abs(axes[runs[-1][-1]] @ axes[joint]) > 1 - _PARALLEL:
            runs[-1].append(joint)
        else:
            runs.append([joint])
    return [tuple(run) for run in runs if len(run) > 1]


def screw_readings(
    model: RobotModel, some: PointObservations, names: FileNames
) -> Iterator[JointInterpretation]:
    """Return, for each slide along the axis of a joint that turns, the rows with the pitch that fits best."""
    axes, turning = _axes_at_zero(model), _turning(model)
    if turning.all():
        return
    for slide in np.flatnonzero(~turning).tolist():
        for turn in (slide - 1, slide + 1):
            if not 0 <= turn < model.axis_count or not turning[turn]:
                continue
            if abs(axes[slide] @ axes[turn]) < 1 - _PARALLEL:
                continue
            pitch_m = _best_pitch_m(model, some, slide, turn)
            if abs(pitch_m) < _LEAST_PITCH_M:
                continue
            yield JointInterpretation(
                "screw",
                1,
                _screwed(some.joints_rad, slide, turn, np.array([pitch_m]))[0],
                make_message(
                    "{slide} also moves by about {pitch_mm:+.1f} mm with each turn of {turn}, as on a ball screw "
                    "with a spline",
                    slide=names.joints[slide],
                    pitch_mm=pitch_m * 1e3,
                    turn=names.joints[turn],
                ),
                make_message(
                    "Record the joints that the controller shows, which leave this out, not those of its motors; "
                    "or add the pitch of the screw (about {pitch_mm:+.1f} mm) for each turn of {turn} to {slide} in "
                    "the file.",
                    slide=names.joints[slide],
                    pitch_mm=pitch_m * 1e3,
                    turn=names.joints[turn],
                ),
            )


def _best_pitch_m(model: RobotModel, some: PointObservations, slide: int, turn: int) -> float:
    def scores_of(pitches_m: Array) -> Array:
        joints = _screwed(some.joints_rad, slide, turn, pitches_m)
        return trimmed_joint_scores(model, joints, some.positions_m)

    return refine_number(scores_of, _WIDEST_PITCH_M, _PITCH_STEPS_M)


def _screwed(joints_rad: Array, slide: int, turn: int, pitches_m: Array) -> Array:
    """Return joints (H, N, n) whose slide also moves by each pitch a turn (H,)."""
    joints = np.repeat(joints_rad[None], len(pitches_m), axis=0)
    joints[:, :, slide] += pitches_m[:, None] * joints_rad[:, turn] / _TURN_RAD
    return joints


def _turning(model: RobotModel) -> NDArray[np.bool_]:
    return np.ones(model.axis_count, dtype=bool) if model.sliding is None else ~model.sliding


def _axes_at_zero(model: RobotModel) -> Array:
    """Return which way each joint turns or slides, seen from the base (n, 3)."""
    rotations, _ = chain_frames(model, np.zeros((1, model.axis_count)))
    axes: Array = rotations[:-1, :, 2, 0] * np.sign(np.diag(model.joint_coupling))[:, None]
    return axes


def _controller_readings(
    model: RobotModel, joints_rad: Array, names: FileNames
) -> Iterator[JointInterpretation]:
    """Return joints of a controller that couples them as those of a description, and the other way."""
    if not _turning(model)[1:3].all():
        return
    coupling, third = model.joint_coupling, names.joints[2]
    signs = np.sign(np.diag(coupling))
    if names.joint_coupling == "geometric":
        back: Array = (coupling @ joints_rad.T).T * signs
        yield JointInterpretation(
            "coupling",
            1,
            back,
            make_message(
                "{third} is what the controller counts, and was taken as an angle against the link before",
                third=third,
            ),
            "Say so: `--joint-coupling controller`.",
        )
        return
    geometric = np.asarray(np.linalg.solve(coupling, (joints_rad * signs).T).T, dtype=np.float64)
    yield JointInterpretation(
        "coupling",
        1,
        geometric,
        make_message(
            "{third} is counted against the link before, as in a description, not as the controller "
            "of this {model_name} counts it",
            third=third,
            model_name=model.label,
        ),
        "Say so: `--joint-coupling geometric`.",
    )


def pair_readings(
    joints_rad: Array, names: FileNames, at: int, coupled: int
) -> Iterator[JointInterpretation]:
    """Return joints of which one column holds the angle of its joint less, or plus, that of another."""
    second, third = names.joints[at], names.joints[coupled]
    for sign, word, verb in (
        (1.0, "less", make_message("Add {second} to {third}", second=second, third=third)),
        (-1.0, "plus", make_message("Subtract {second} from {third}", second=second, third=third)),
    ):
        changed = joints_rad.copy()
        changed[:, coupled] += sign * joints_rad[:, at]
        yield JointInterpretation(
            "coupling",
            1,
            changed,
            make_message(
                "{third} holds the angle of the joint {word} that of {second} (joints that are coupled)",
                third=third,
                word=word,
                second=second,
            ),
            make_message(
                "{verb} in the file, or name the robot whose controller couples its joints.", verb=verb
            ),
        )


def _absolute_readings(
    model: RobotModel, joints_rad: Array, names: FileNames, run: Sequence[int]
) -> Iterator[JointInterpretation]:
    """Return joints of parallel axes some of which count against what stands before all of these axes."""
    axes = _axes_at_zero(model)
    later = [s for size in range(1, len(run)) for s in itertools.combinations(run[1:], size)]
    for counted in later:
        if counted == (run[1],):  # a pair
            continue
        changed, formulas = joints_rad.copy(), []
        for joint in counted:
            at, formula = run.index(joint), names.joints[joint]
            since = max((run.index(other) for other in counted if other < joint), default=0)
            for before in run[:at]:
                sign = np.sign(axes[before] @ axes[joint])
                changed[:, joint] -= sign * changed[:, before]
                if run.index(before) >= since:
                    formula += f" {'-' if sign > 0 else '+'} {names.joints[before]}"
            formulas.append(f"{names.joints[joint]} = {formula}")
        which = join_words([names.joints[joint] for joint in counted])
        yield JointInterpretation(
            "coupling",
            1 if len(counted) in (1, len(run) - 1) else 2,
            changed,
            make_message("{which} counts against the first of these parallel axes", which=which)
            if len(counted) == 1
            else make_message("{which} count against the first of these parallel axes", which=which),
            make_message(
                "Write the angle against the link before in the file: {formulas}; or describe the coupling in a "
                "model file (`interaction`).",
                formulas="; ".join(formulas),
            ),
        )
