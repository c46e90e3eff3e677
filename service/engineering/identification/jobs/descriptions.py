"""A robot described by a file beside its measurements: with a track or a positioner as joints of its chain."""

from dataclasses import dataclass
from pathlib import Path

from cellcal.calibration.arm.mounting import FILE_ENDINGS
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import make_message
from cellcal.service.engineering.identification.jobs.shapes import DESCRIBED, RobotDescription
from cellcal.service.engineering.measured.embedded_files import content_of, plain_name

MOST_BYTES = 4 << 20
NOT_SAVABLE = {
    "message": "the robot was described by a file beside the measurements: its parameters belong to that "
    "description, and not to the model that the cell file names.",
    "remedy": "Name the description as model of the robot in the cell file, and identify again.",
}


@dataclass(frozen=True, eq=False)
class DescribedRobot:
    """A description as it arrived."""

    file_name: str  # without the name that it arrived with, which may hold marks of a reference
    content: bytes
    reference: str  # relative to the folder that it is written into

    def write_file(self, folder: Path) -> None:
        """Write it into its folder of a job."""
        (folder / DESCRIBED).mkdir()
        (folder / DESCRIBED / self.file_name).write_bytes(self.content)


def read_description(description: RobotDescription) -> DescribedRobot:
    """Return a described robot by its file, base and tip; what the file holds is read by the job.

    Raises
    ------
    CellError
        Another kind of file, one that is too large, or links of a model file, which states its own.
    """
    name = plain_name(description.file.name, "description")
    ending = Path(name).suffix.lower()
    if ending not in FILE_ENDINGS:
        raise CellError(
            make_message(
                "{name} describes no robot: its ending is none of {endings}.",
                name=name,
                endings=", ".join(sorted(FILE_ENDINGS)),
            ),
            remedy="Bring a URDF with every xacro expanded, or a model file.",
            code="usage",
        )
    content = content_of(description.file.content_base64, name)
    if len(content) > MOST_BYTES:
        raise CellError(
            make_message("{name} is larger than {most} MB.", name=name, most=MOST_BYTES >> 20),
            remedy="Leave meshes out of the description.",
            code="usage",
        )
    links = [f"{key}={link}" for key, link in (("base", description.base), ("tip", description.tip)) if link]
    file_name = f"description{ending}"
    return DescribedRobot(file_name, content, file_name + (f"?{'&'.join(links)}" if links else ""))
