"""Small motion programs for a pendant (level L1): written here, loaded, compared and started by a person."""

import re
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from cellcal.drivers.interfaces import Joints
from cellcal.drivers.registry import PROGRAM_WRITERS, RobotConfig
from cellcal.drivers.wire.program_file import ProgramHeader, ProgramWriter
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.files import make_private_folder

NO_SAFETY_FUNCTION = (
    "This software performs no safety function. Emergency stop, protective stop, enabling device, speed and space "
    "monitoring are functions of the robot controller and the cell. Do not rely on this screen to stop the robot."
)


@dataclass(frozen=True, slots=True)
class PendantPrograms:
    """The folder in which programs for one robot are put; each carries a token that names its very moves."""

    folder: Path
    robot: str
    serial: str
    writer: ProgramWriter

    def write_program(self, way_rad: tuple[Joints, ...], speed_rad_s: float) -> str:
        """Write joint moves along a way; the same moves give the same file."""
        token = sha256(repr((self.serial, way_rad, speed_rad_s)).encode()).hexdigest()[:8].upper()
        name = f"CC{token}"
        make_private_folder(self.folder)
        header = ProgramHeader(name, token, f"robot {self.robot}, serial {self.serial}", NO_SAFETY_FUNCTION)
        path = self.folder / f"{name}{self.writer.suffix}"
        path.write_text(self.writer.write(header, way_rad, speed_rad_s), encoding="ascii", errors="replace")
        return str(path)


def program_shelf(config: CellConfig, entry: RobotConfig) -> PendantPrograms | None:
    """Return where programs for a robot are put; None where its language is unknown."""
    writer = PROGRAM_WRITERS.get(entry.pendant_language)
    if writer is None:
        return None
    folder = config.cell.data_dir / "programs" / re.sub(r"[^A-Za-z0-9_-]", "_", entry.name)
    return PendantPrograms(folder, entry.name, entry.serial, writer)
