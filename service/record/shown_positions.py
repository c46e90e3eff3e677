"""What controllers showed of their zero at the last look that found nothing wrong: one small file per robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellcal.service.record.robot_files import RobotFiles
from cellcal.service.times import read_time

Datum = tuple[str, int | None]  # as the maker calls it, and the axis from 0 that it belongs to


@dataclass(frozen=True, slots=True)
class KeptPosition:
    """Data of one robot's zero, and where its log ended."""

    robot: str
    serial: str
    values: Mapping[Datum, str]
    marks: tuple[str, ...]  # of the newest entries of its log
    reference_key: str  # the SHA-256 of the position record in force then, or the run of a cure; "" without
    seen_utc: str
    lost_utc: str = ""  # when a lost position was seen that no record, cure or person has answered since
    lost_words: str = ""
    lost_axes: tuple[int, ...] = ()  # from 1
    answered_run: str = ""  # of a cure without a proof that a person accepted
    accepted_utc: str = ""  # when a person accepted last what was shown


class KeptPositions:
    """One small file per robot, replaced atomically."""

    def __init__(self, data_dir: Path) -> None:
        self._files = RobotFiles(data_dir, "shown_position", "the position kept")

    def load(self, robot: str) -> KeptPosition | None:
        """Return what was kept last, or None where nothing (readable) is stored."""
        return self._files.load_content(robot, _parse_position)

    def save(self, baseline: KeptPosition) -> None:
        """Replace the file so that a crash leaves the old or the new one, never half of it."""
        values = [[name, axis, value] for (name, axis), value in baseline.values.items()]
        document = {
            "robot": baseline.robot,
            "serial": baseline.serial,
            "values": values,
            "marks": list(baseline.marks),
            "record_sha256": baseline.reference_key,
            "seen_utc": baseline.seen_utc,
            "lost": [baseline.lost_utc, baseline.lost_words, list(baseline.lost_axes)],
            "answered_run": baseline.answered_run,
            "accepted_utc": baseline.accepted_utc,
        }
        self._files.save_document(baseline.robot, document)


def _parse_position(document: Any) -> KeptPosition:
    values = {
        (str(name), None if axis is None else int(axis)): str(value)
        for name, axis, value in document["values"]
    }
    read_time(document["seen_utc"])
    lost_utc, lost_words, lost_axes = document.get("lost", ("", "", ()))
    return KeptPosition(
        robot=str(document["robot"]),
        serial=str(document["serial"]),
        values=values,
        marks=tuple(str(mark) for mark in document["marks"]),
        reference_key=str(document["record_sha256"]),
        seen_utc=str(document["seen_utc"]),
        lost_utc=str(lost_utc),
        lost_words=str(lost_words),
        lost_axes=tuple(int(axis) for axis in lost_axes),
        answered_run=str(document.get("answered_run", "")),
        accepted_utc=str(document.get("accepted_utc", "")),
    )
