"""Causes of a misfit that are looked for once no reading of joints and positions explains it."""

from dataclasses import dataclass

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.identification.misfit_coordinates import coordinate_causes
from cellcal.calibration.identification.misfit_doubles import double_causes
from cellcal.calibration.identification.misfit_elsewhere import outer_causes
from cellcal.calibration.identification.misfit_error import MisfitCause
from cellcal.calibration.identification.misfit_fit import fit_quickly, places_only
from cellcal.calibration.identification.misfit_hypotheses import FileNames
from cellcal.calibration.identification.misfit_joint_columns import joint_column_causes
from cellcal.calibration.identification.misfit_pairing import pairing_causes
from cellcal.calibration.identification.misfit_turns import turn_causes
from cellcal.calibration.identification.mixed_targets import find_mixed_targets
from cellcal.calibration.identification.observations import Observations, Rows
from cellcal.calibration.identification.target_change import series_columns


@dataclass(frozen=True, eq=False)
class LateSearch:
    """Rows that nothing explains yet; ``rows`` are those of the series that are looked at."""

    model: RobotModel
    series: Observations
    rows: Rows
    names: FileNames
    limit_m: float  # of what rows that are explained leave

    def find_causes(self) -> tuple[MisfitCause, ...]:
        """Return what explains them; empty where nothing does."""
        places = places_only(self.series)
        return (
            self._outer_causes()
            or pairing_causes(self.model, places, fit_quickly, self.limit_m)
            or self._mixed_targets()
            or turn_causes(self.model, places, self.limit_m)
            or coordinate_causes(self.model, places, self.names, self.limit_m)
            or joint_column_causes(self.model, places, self.rows, self.names, fit_quickly, self.limit_m)
            or double_causes(self.model, places, self.rows, self.names, self.limit_m)
        )

    def _outer_causes(self) -> tuple[MisfitCause, ...]:
        columns = {name: values[self.rows] for name, values in self.names.columns.items()}
        some = places_only(self.series.select_rows(self.rows))
        return outer_causes(self.model, some, columns, fit_quickly, self.limit_m)

    def _mixed_targets(self) -> tuple[MisfitCause, ...]:
        found = find_mixed_targets(series_columns(self.model, self.series), self.series)
        if found is None or found.remaining_m > self.limit_m:
            return ()
        return (found.as_cause(self.names.rows),)
