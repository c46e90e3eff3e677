"""How surely an identified arm says where its target is, at every point that is asked for."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cellcal.calibration.arm.joint_kinds import joint_columns_of, shown_units
from cellcal.calibration.compensation.pose_gap import TipArm
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.error_tails import MANY_REJECTED
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.identification.reading_prediction import predict_readings
from cellcal.service.csv_writing import write_rows
from cellcal.service.engineering.identification.at_points import AtPoints, solve_joints
from cellcal.service.engineering.identification.identify import IdentifyReport
from cellcal.service.engineering.measured.usable_rows import REPEAT

_PROBABILITY = 0.95


@dataclass(frozen=True, eq=False)
class TipsAt:
    """Predicted readings of the target with their uncertainty, the points in the order of the file."""

    joints_rad: Array  # (N, n)
    positions_m: Array  # (N, 3)
    sigmas_m: Array  # (N, 3) of each coordinate of a reading: parameters, device, and what the model lacks
    sigma_m: Array  # (N,) of the distance
    expanded_m: Array  # (N,) radius in space that holds 95 % of readings
    parameters_expanded_m: Array  # (N,) the same for the parameters alone, as if the model lacked nothing
    outside: tuple[int, ...]  # points that turn a joint further than any fitted row
    far: tuple[int, ...]  # points that are known worse than any posture among the fitted rows
    frame: str
    statement: tuple[str, ...]  # what the 95 % are about, and what they do not cover
    shown: tuple[Array, tuple[str, ...]] | None = (
        None  # factors to degrees and millimetres, and columns of joints
    )

    def as_document(self) -> dict[str, object]:
        """Return the object that ``--json`` holds."""
        columns = zip(
            self.positions_m,
            self.sigmas_m,
            self.sigma_m,
            self.expanded_m,
            self.parameters_expanded_m,
            strict=True,
        )
        return {
            "frame": self.frame,
            "probability": _PROBABILITY,
            "statement": list(self.statement),
            "points": [
                {
                    "joints_rad": self.joints_rad[i].tolist(),
                    "position_m": position.tolist(),
                    "sigmas_m": sigmas.tolist(),
                    "sigma_m": float(sigma),
                    "expanded_m": float(expanded),
                    "coverage_factor": float(expanded / sigma) if sigma > 0 else 0.0,
                    "parameters_expanded_m": float(alone),
                    "extrapolated": i in self.outside,
                    "far_from_rows": i in self.far,
                }
                for i, (position, sigmas, sigma, expanded, alone) in enumerate(columns)
            ],
        }


def tips_at(points: AtPoints, report: IdentifyReport, *, identified: bool) -> TipsAt:
    """Predict readings of the target at the joints, or flange poses, of points (see `at_points`).

    Raises
    ------
    MeasurementError
        Poses are out of reach.
    """
    found = report.identification
    state = found.state
    joints = points.joints_rad
    if points.base_flange is not None:
        arm = replace(TipArm.of_state(state), flange_tip=np.eye(4)) if identified else TipArm(state.nominal)
        joints = solve_joints(points, arm, found.robust.problem.observations.joints_rad)
    readings = predict_readings(found, joints)
    lengths = report.measurements.observations.kind == "length"
    error = readings.model_error
    learnt = f"{error.rows} rows held out among their neighbours"
    if error.far_rows:
        learnt += f" and {error.far_rows} in regions held out whole"
    if error.tail_rows:
        learnt += f"; with {error.tail_rows} that the fit left out as the long tail of this arm's errors"
    predicted = tips_of(
        joints,
        readings.positions_m,
        (readings.covariances_m2, readings.expanded_m, readings.parameters_expanded_m),
        (np.flatnonzero(readings.beyond), np.flatnonzero(readings.far)),
        "robot base" if lengths else "measuring device",
        statement_of(learnt, report.rows, _left_out(report) - error.tail_rows, far=bool(readings.far.any())),
    )
    return replace(predicted, shown=(shown_units(state.nominal)[0], joint_columns_of(state.nominal)))


def tips_of(
    joints_rad: Array,
    positions_m: Array,
    spread: tuple[Array, Array, Array],
    marked: tuple[Rows, Rows],
    frame: str,
    statement: tuple[str, ...],
) -> TipsAt:
    """Return predictions from their covariances (N, 3, 3) and both radii (N,), and from the points marked."""
    covariances, expanded, alone = spread
    outside, far = marked
    variances = np.maximum(np.einsum("nii->ni", covariances), 0.0)
    return TipsAt(
        joints_rad,
        positions_m,
        np.sqrt(variances),
        np.sqrt(variances.sum(axis=1)),
        expanded,
        alone,
        tuple(int(i) for i in outside),
        tuple(int(i) for i in far),
        frame,
        statement,
    )


def _left_out(report: IdentifyReport) -> int:
    """Return how many rows the statement does not cover; a copy of a row that is covered is no other reading."""
    return sum(row.kind != REPEAT for row in report.rejected)


def statement_of(learnt: str, rows: int, rejected: int, *, far: bool) -> tuple[str, ...]:
    """Say what the 95 % are about, and what they do not cover."""
    sentences = [
        "95 %: a further reading of the same target by the same device lies within this distance in space, all "
        f"coordinates together; parameters, device and what the model lacks are counted, the last from {learnt}."
    ]
    if rejected:
        sentences.append(f"Not covered: readings such as the {rejected} of {rows} that were rejected.")
    if rejected > MANY_REJECTED * rows:
        share = _PROBABILITY * (1.0 - rejected / rows)
        sentences.append(
            f"Those are too many to be mistakes alone: of all further readings about {share:.0%} are within this "
            "distance."
        )
    if far:
        sentences.append(
            "Points marked * turn a joint further than any fitted row, or are known worse than the postures among "
            "the rows: what levels of the model disagree about is added there, but no row proves it."
        )
    sentences.append(
        "Not covered: another payload, another temperature, wear, or a device or target that was moved since."
    )
    return tuple(sentences)


def write_tips(tips: TipsAt, path: Path) -> None:
    """Write the points as CSV: degrees and millimetres.

    Raises
    ------
    FileExistsError
        The file is there already.
    """
    factors = np.full(tips.joints_rad.shape[1], np.degrees(1.0)) if tips.shown is None else tips.shown[0]
    names = list(tips.shown[1] if tips.shown else (f"q{i + 1}_deg" for i in range(len(factors))))
    names += ["x_mm", "y_mm", "z_mm", "sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_mm", "u95_mm"]
    names += ["extrapolated", "u95_parameters_mm", "far_from_rows"]
    with path.open("x", encoding="utf-8", newline="") as file:
        write_rows(file, [names])
        for i, joints in enumerate(tips.joints_rad * factors):
            sizes = [*tips.positions_m[i], *tips.sigmas_m[i], tips.sigma_m[i], tips.expanded_m[i]]
            numbers = [*(f"{v:.6f}" for v in joints), *(f"{v * 1e3:.5f}" for v in sizes)]
            marks = ["yes" if i in marked else "no" for marked in (tips.outside, tips.far)]
            alone = f"{tips.parameters_expanded_m[i] * 1e3:.5f}"
            write_rows(file, [[*numbers, marks[0], alone, marks[1]]])
