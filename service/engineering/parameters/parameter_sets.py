"""Parameter sets of robots: text files with versions that are never overwritten and whose changes are detected.

One folder a robot, one TOML file a version. Going back is a new version that names the old one: nothing is ever
removed.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from cellcal.calibration.documents.plain_files import read_plain_text
from cellcal.calibration.message import make_message
from cellcal.service.engineering.parameters.parameter_set import (
    ParameterSet,
    ParameterSetError,
    ParameterValue,
    parse_set,
    to_text,
)
from cellcal.service.files import create_file, make_private_folder

_SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """One value in two sets; ``None`` where a set does not have it."""

    name: str
    unit: str
    before: ParameterValue | None
    after: ParameterValue | None

    @property
    def is_determined(self) -> bool:
        """Whether a measurement confirms each of the two sets."""
        return all(value.determined for value in (self.before, self.after) if value is not None)

    @property
    def value_difference(self) -> float:
        """After minus before; a value that is not there is nominal."""
        return (self.after.value if self.after else 0.0) - (self.before.value if self.before else 0.0)

    @property
    def difference_in_sigmas(self) -> float | None:
        """The difference in combined standard uncertainties; None where neither is known, or one is no result."""
        if not self.is_determined:
            return None
        spreads = [v.standard_uncertainty for v in (self.before, self.after) if v is not None]
        sigmas = [spread for spread in spreads if spread]
        return abs(self.value_difference) / math.hypot(*sigmas) if sigmas else None


class ParameterSets:
    """A folder of parameter sets."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def robot_serials(self) -> tuple[str, ...]:
        """Return the serials of all robots that have sets."""
        if not self._folder.is_dir():
            return ()
        return tuple(sorted(item.name for item in self._folder.iterdir() if _stored_versions(item)))

    def load_history(self, robot_serial: str) -> tuple[ParameterSet, ...]:
        """Return all versions, oldest first, each proved to follow the one before.

        Raises
        ------
        ParameterSetError
            No such robot; or a file that is missing, damaged or from elsewhere.
        """
        folder = self._folder / _check_serial(robot_serial)
        numbers = _stored_versions(folder)
        if not numbers:
            serials = ", ".join(self.robot_serials()) or "none"
            raise ParameterSetError(
                make_message(
                    "there are no parameter sets of robot {robot_serial}.",
                    robot_serial=robot_serial,
                ),
                remedy=make_message(
                    "Robots with sets here: {serials}.",
                    serials=serials,
                ),
                code="usage",
            )
        sets: list[ParameterSet] = []
        for number in range(1, numbers[-1] + 1):
            path = folder / _file_name(number)
            if number not in numbers:
                raise ParameterSetError(
                    make_message(
                        "{name} is missing.",
                        name=path,
                    ),
                    remedy="Restore it from a backup.",
                )
            found = parse_set(read_plain_text(path), str(path))
            before = sets[-1].sha256 if sets else ""
            if (found.version, found.robot_serial, found.previous_sha256) != (number, robot_serial, before):
                raise ParameterSetError(
                    make_message(
                        "{path} does not follow version {version} of robot {robot_serial}.",
                        path=path,
                        version=number - 1,
                        robot_serial=robot_serial,
                    ),
                    remedy="Restore the folder from a backup; import a foreign file as a new version.",
                )
            sets.append(found)
        return tuple(sets)

    def load_set(self, robot_serial: str, version: int | None = None) -> ParameterSet:
        """Return a version, or the newest."""
        sets = self.load_history(robot_serial)
        if version is None:
            return sets[-1]
        if not 1 <= version <= len(sets):
            raise ParameterSetError(
                make_message(
                    "robot {robot_serial} has no version {version}.",
                    robot_serial=robot_serial,
                    version=version,
                ),
                remedy=make_message(
                    "There are versions 1 to {newest}.",
                    newest=len(sets),
                ),
                code="usage",
            )
        return sets[version - 1]

    def save_draft(self, draft: ParameterSet) -> ParameterSet:
        """Write a draft as the next version, whole or not at all; another writer is never overwritten."""
        folder = self._folder / _check_serial(draft.robot_serial)
        before = self.load_set(draft.robot_serial) if _stored_versions(folder) else None
        saved = replace(
            draft,
            version=before.version + 1 if before else 1,
            previous_sha256=before.sha256 if before else "",
        )
        make_private_folder(folder)
        _write_new(folder / _file_name(saved.version), to_text(saved))
        return saved

    def roll_back(
        self, robot_serial: str, version: int, *, made_by: str, made_at: str, note: str = ""
    ) -> ParameterSet:
        """Write the values of an old version as a new one that names it."""
        old = self.load_set(robot_serial, version)
        draft = replace(
            old,
            made_by=made_by,
            made_at=made_at,
            note=note,
            rolls_back_to=version,
        )
        return self.save_draft(draft)


def compare_sets(before: ParameterSet, after: ParameterSet) -> tuple[ParameterChange, ...]:
    """Return every value that is not the same in both, in the order of the newer set."""
    names = [value.name for value in after.values]
    names += [value.name for value in before.values if value.name not in set(names)]
    changes = []
    for name in names:
        old, new = before.find_value(name), after.find_value(name)
        if old != new:
            unit = (new or old or ParameterValue(name, "1", 0.0)).unit
            changes.append(ParameterChange(name, unit, old, new))
    return tuple(changes)


def _check_serial(text: str) -> str:
    if not _SERIAL.fullmatch(text):
        raise ParameterSetError(
            make_message("{text!r} cannot name a robot.", text=text),
            remedy="Use letters, digits, dot, dash and underscore.",
            code="usage",
        )
    return text


def _file_name(version: int) -> str:
    return f"v{version:04d}.toml"


def _stored_versions(folder: Path) -> Sequence[int]:
    if not folder.is_dir():
        return ()
    names = [re.fullmatch(r"v(\d{4,})\.toml", item.name) for item in folder.iterdir()]
    return sorted(int(name[1]) for name in names if name)


def _write_new(path: Path, text: str) -> None:
    try:
        create_file(path, text.encode())
    except FileExistsError as taken:
        raise ParameterSetError(
            make_message("{path} was written by another process just now.", path=path), remedy="Try again."
        ) from taken


FOLDER = "parameter_sets"  # beside the cell file, where `cellcal parameters` keeps them when it runs there
