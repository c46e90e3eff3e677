"""Files that `cellcal identify` leaves: a parameter set, a description, and tables for a project of programs."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cellcal.service.engineering.identification.identify import IdentifyReport


@dataclass(frozen=True, slots=True)
class IdentifyOutputs:
    """Files to write when the identification is done."""

    save: Path | None
    serial: str
    by: str
    urdf: Path | None
    geometric_joints: bool
    project_axes: Path | None

    def refuse_unwritable(self, robot: str, *, residual_model: bool) -> None:
        """Refuse before the work rather than after it."""
        from cellcal.service.engineering.identification.identify_outputs import refuse_saving
        from cellcal.service.engineering.identification.project_axes import AXES_FILE, needs_owner
        from cellcal.service.engineering.measured.table import MeasurementError

        if residual_model:
            refuse_saving(self.save, self.urdf, self.project_axes)
        # A positioner's tables are of no robot: then nobody has to be named.
        makes_set = self.save is not None or (self.project_axes is not None and needs_owner(robot))
        if makes_set and not (self.serial and self.by):
            raise MeasurementError(
                "a parameter set belongs to one robot and to the person who measured it.",
                remedy="Give `--serial` and `--by`.",
            )
        if self.project_axes is not None and (self.project_axes / AXES_FILE).exists():
            raise MeasurementError(
                f"{self.project_axes / AXES_FILE} is there already, perhaps with what its owner added.",
                remedy="Name another folder, or move that file away.",
            )

    def write_files(self, report: "IdentifyReport", measurements: Path) -> None:
        """Write them."""
        import datetime

        from cellcal.service.cli.printing import STDERR_CONSOLE
        from cellcal.service.engineering.identification.identify_outputs import (
            save_identification,
            write_identified_urdf,
        )
        from cellcal.service.engineering.identification.project_axes import write_project_axes
        from cellcal.service.engineering.parameters.parameter_files import SetOrigin

        who = SetOrigin(
            self.serial, self.by, datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        )
        if self.save is not None:
            made = save_identification(report, measurements, self.save, who)
            STDERR_CONSOLE.print(f"saved version {made.version} of robot {made.robot_serial}", markup=False)
        if self.urdf is not None:
            missing = write_identified_urdf(report, self.urdf, geometric_joints=self.geometric_joints)
            without = f", without {' and '.join(missing)}, which a description cannot hold" if missing else ""
            STDERR_CONSOLE.print(f"wrote {self.urdf}{without}", markup=False)
        if self.project_axes is not None:
            for path in write_project_axes(report, measurements, self.project_axes, who):
                STDERR_CONSOLE.print(f"wrote {path}", markup=False)
