"""Rows that a fit left out and that belong together: of another robot, another station, or another target."""

from dataclasses import dataclass, replace

import numpy as np

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.estimator import FitProblem, errors_m
from cellcal.calibration.identification.identify import Identification
from cellcal.calibration.identification.lints import Lint
from cellcal.calibration.identification.misfit_fit import fit_quickly
from cellcal.calibration.identification.observations import LengthObservations, Rows, with_mounting
from cellcal.calibration.message import join_messages, make_message

_FEWEST_ROWS = 8  # that a fit of base, tool and zeros tells something about
_SHARE = 0.1  # of all rows
_FAR = 10.0  # times what the robot is off as made
_NEAR = 3.0
_MOSTLY = 0.5
_MOST_RANGES = 4


@dataclass(frozen=True, eq=False)
class RowsApart:
    """Rows that a fit left out, far off all others."""

    rows: Rows  # of the series
    fits_alone: bool  # they fit the robot by themselves, from another place

    def describe_in_file(self, model: RobotModel, file_rows: Rows) -> Lint:
        """Return the note that names them; ``file_rows`` are the numbers of the series' rows in the file."""
        listed = describe_rows(file_rows[self.rows])
        if self.fits_alone:
            says = make_message(
                "{count} rows that are far off the others ({listed}; the first is row 0) fit {model_name} by "
                "themselves: another station of the device, another target, or another robot of this kind. "
                "Identify them from a file of their own.",
                count=len(self.rows),
                listed=listed,
                model_name=model.label,
            )
        else:
            says = make_message(
                "{count} rows that are far off the others ({listed}; the first is row 0) do not fit {model_name} by "
                "themselves either: another robot, or readings of something else. Take them out of the file.",
                count=len(self.rows),
                listed=listed,
                model_name=model.label,
            )
        return Lint("apart", says, tuple(int(row) for row in file_rows[self.rows]))


def find_rows_apart(found: Identification) -> RowsApart | None:
    """Return rows far off all others, where they are so many that chance leaves no such."""
    observations = found.robust.problem.observations
    apart, mounting = _apart(found)
    if len(apart) < max(_FEWEST_ROWS, _SHARE * len(observations)) or isinstance(
        observations, LengthObservations
    ):
        return None
    others = np.setdiff1d(np.arange(len(observations)), apart)
    frames = FitProblem.from_observations(found.frames, observations)
    usual_m = float(np.median(errors_m(found.frames, frames)[others]))
    seen = FitProblem.from_observations(found.state, with_mounting(observations, mounting))
    if float(np.median(errors_m(found.state, seen)[apart])) < _FAR * usual_m:
        return None
    alone_m = fit_quickly(found.state.nominal, observations.select_rows(apart)).score_m
    return RowsApart(apart, alone_m <= _NEAR * usual_m)


def rows_apart(found: Identification, file_rows: Rows) -> list[Lint]:
    """Name rows far off all others, whether they fit the robot by themselves, and how well the others do.

    Parameters
    ----------
    found : Identification
        Its rows are those of the series, in order.
    file_rows : (N,)
        Their numbers in the file.
    """
    apart = find_rows_apart(found)
    if apart is None:
        return []
    lint = apart.describe_in_file(found.state.nominal, file_rows)
    others = np.setdiff1d(np.arange(len(found.fit_m)), apart.rows)
    return [replace(lint, message=join_messages(" ", [lint.message, *_describe_others(found, others)]))]


def _apart(found: Identification) -> tuple[Rows, Rows]:
    """Return rejected rows with what is left of mountings that were mostly rejected, and the mounting of every row.

    Such a mounting is none: its rows count as seen from where most of the series was measured.
    """
    observations = found.robust.problem.observations
    rejected = np.zeros(len(observations), dtype=bool)
    rejected[found.rejected] = True
    mounting = observations.mounting.copy()
    usual = int(np.bincount(mounting[~rejected]).argmax())
    for each in np.unique(mounting):
        here = observations.mounting == each
        if rejected[here].mean() > _MOSTLY:
            rejected |= here
            mounting[here] = usual
    return np.flatnonzero(rejected), mounting


def _describe_others(found: Identification, others: Rows) -> list[str]:
    held_out_m = found.judgement.held_out_m
    if len(held_out_m) != len(found.fit_m):
        return []
    rmse_mm = float(np.sqrt(np.mean(held_out_m[others] ** 2))) * 1e3
    return [make_message("All other rows: {rmse_mm:.3f} mm held out.", rmse_mm=rmse_mm)]


def describe_rows(rows: Rows, most: int = _MOST_RANGES) -> str:
    """Return numbers of rows as ranges, the first of them."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    names = [
        make_message("{first} to {last}", first=int(part[0]), last=int(part[-1]))
        if len(part) > 1
        else make_message("{first}", first=int(part[0]))
        for part in parts[:most]
    ]
    if len(parts) > most:
        names.append("…")
    return join_messages(", ", names)
