"""How surely an identified arm says where its target is, at every point that is asked for."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.compensation.pose_gap import Arm
from calibration.geometry import Array
from calibration.identification.lints import beyond_fitted_range
from calibration.identification.tip_uncertainty import predict_tips
from service.csv_writing import write_rows
from service.identification.at_points import AtOptions, read_points, solved
from service.identification.identify import IdentifyReport
from service.measured.table import MeasurementError


@dataclass(frozen=True, eq=False)
class TipsAt:
    """Predicted places with their uncertainty, the points in the order of the file."""

    joints_rad: Array  # (N, n)
    positions_m: Array  # (N, 3)
    sigmas_m: Array  # (N, 3) of each coordinate: parameters, and the residual model where it is used
    sigma_m: Array  # (N,) of the distance
    expanded_m: Array  # (N,) 95 %, in the worst direction
    outside: tuple[int, ...]  # points that turn a joint further than any fitted row
    frame: str
    coverage: float

    def as_document(self) -> dict[str, Any]:
        """Return the object that ``--json`` holds."""
        columns = zip(self.positions_m, self.sigmas_m, self.sigma_m, self.expanded_m, strict=True)
        return {
            "frame": self.frame,
            "coverage_factor": self.coverage,
            "points": [
                {
                    "joints_rad": self.joints_rad[i].tolist(),
                    "position_m": position.tolist(),
                    "sigmas_m": sigmas.tolist(),
                    "sigma_m": float(sigma),
                    "expanded_m": float(expanded),
                    "extrapolated": i in self.outside,
                }
                for i, (position, sigmas, sigma, expanded) in enumerate(columns)
            ],
        }


def tips_at(options: AtOptions, report: IdentifyReport) -> TipsAt:
    """Predict the target's place at the joints, or flange poses, of a CSV file (`service.identification.at_points`).

    Raises
    ------
    MeasurementError
        The file has no points that can be read, or poses that are out of reach.
    """
    found = report.identification
    state = found.state
    points = read_points(options, state.nominal.axes)
    arm = replace(Arm.of_state(state), flange_tip=np.eye(4)) if options.identified else Arm(state.nominal)
    joints = solved(points, arm, found.robust.problem.observations.joints_rad)
    tips = predict_tips(found.robust.fit, joints)
    positions, covariance = tips.positions_m, tips.covariance_m2
    if found.residual is not None and found.residual.chosen:
        left, sigma = found.residual.model.predict(joints)
        positions = positions + left @ found.state.devices[-1].device_base[:3, :3].T
        covariance = covariance + sigma[:, None, None] ** 2 * np.eye(3)
    lengths = report.measurements.observations.kind == "length"
    beyond = beyond_fitted_range(found.robust.problem.observations.joints_rad, joints)
    return TipsAt(
        joints,
        positions,
        np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0)),
        np.sqrt(np.maximum(np.einsum("nii->n", covariance), 0.0)),
        report.coverage * np.sqrt(np.maximum(np.linalg.eigvalsh(covariance)[:, -1], 0.0)),
        beyond[0].rows if beyond else (),
        "robot base" if lengths else "measuring device",
        report.coverage,
    )


def write_tips(tips: TipsAt, path: Path) -> None:
    """Write the points as CSV: degrees and millimetres.

    Raises
    ------
    MeasurementError
        The file is there already.
    """
    if path.exists():
        raise MeasurementError(f"{path} is there already.", remedy="Name a file that does not exist.")
    names = [f"q{i + 1}_deg" for i in range(tips.joints_rad.shape[1])]
    names += ["x_mm", "y_mm", "z_mm", "sigma_x_mm", "sigma_y_mm", "sigma_z_mm", "sigma_mm", "u95_mm"]
    names += ["extrapolated"]
    with path.open("w", encoding="utf-8", newline="") as file:
        write_rows(file, [names])
        for i, joints in enumerate(np.rad2deg(tips.joints_rad)):
            sizes = [*tips.positions_m[i], *tips.sigmas_m[i], tips.sigma_m[i], tips.expanded_m[i]]
            numbers = [*(f"{v:.6f}" for v in joints), *(f"{v * 1e3:.5f}" for v in sizes)]
            write_rows(file, [[*numbers, "yes" if i in tips.outside else "no"]])
