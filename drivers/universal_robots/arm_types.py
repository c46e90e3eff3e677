"""Which arm answers: judged from the software version, the type code and the name that the dashboard tells.

A code alone does not say it: a UR7e reports that of a UR5, a UR12e that of a UR10, and the codes of the CB3 arms are
those of the e-Series. What cannot be told apart is named, never guessed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError, WrongDeviceError
from cellcal.drivers.universal_robots.state import UPDATE, ControllerVersion
from cellcal.drivers.wire.tables import read_table_rows

_PACKAGE = "cellcal.drivers.universal_robots"
_CB3 = "CB3"
_READ_THE_LABEL = (
    "Compare the label on the arm with the model in the cell file, and correct it or the address."
)


class ControllerKind(StrEnum):
    """Generations of controllers, which differ in their interfaces."""

    CB3 = "CB3"
    POLYSCOPE_5 = "PolyScope 5"
    POLYSCOPE_X = "PolyScope X"


# The oldest software that this driver reads: a name plate over the network, or the Robot API.
OLDEST = {
    ControllerKind.CB3: (3, 12),
    ControllerKind.POLYSCOPE_5: (5, 6),
    ControllerKind.POLYSCOPE_X: (10, 11),
}
_KIND_OF_MAJOR = {
    3: ControllerKind.CB3,
    5: ControllerKind.POLYSCOPE_5,
    10: ControllerKind.POLYSCOPE_X,
}


@dataclass(frozen=True, slots=True)
class ArmType:
    """One arm of the maker; ``since`` names the first software that runs it, by kind of controller."""

    model: str
    code: int
    series: str
    dashboard_names: tuple[str, ...]
    since: tuple[tuple[ControllerKind, tuple[int, int]], ...]

    @property
    def is_cb3(self) -> bool:
        """Whether its controller is a CB3."""
        return self.series == _CB3

    def runs_on(self, version: ControllerVersion) -> bool:
        """Return whether software of this version runs the arm."""
        first = dict(self.since).get(_KIND_OF_MAJOR.get(version.major, ControllerKind.CB3))
        return (
            version.major in _KIND_OF_MAJOR and first is not None and (version.major, version.minor) >= first
        )


@dataclass(frozen=True, slots=True)
class ReportedArm:
    """The arm as its controller reports it."""

    version: ControllerVersion
    type_code: int  # of the primary interface
    dashboard_name: str | None = None  # None: a controller without a dashboard


@cache
def arm_types() -> dict[str, ArmType]:
    """Return all arms by their models."""
    found = {}
    for row in read_table_rows(_PACKAGE, "arm_types.tsv"):
        columns = zip(ControllerKind, ("since_cb3", "since_5", "since_x"), strict=True)
        since = tuple((kind, _first_version(row[column])) for kind, column in columns if row[column] != "-")
        names = tuple(row["dashboard"].split(","))
        found[row["model"]] = ArmType(row["model"], int(row["code"]), row["series"], names, since)
    return found


def controller_kind(device: str, version: ControllerVersion) -> ControllerKind:
    """Return which generation of controller this software runs on.

    Raises
    ------
    RefusedError
        Software that this driver does not know.
    """
    kind = _KIND_OF_MAJOR.get(version.major)
    if kind is None or (version.major, version.minor) < OLDEST[kind]:
        raise RefusedError(
            device,
            make_message(
                "the controller runs software {version}, which this driver does not know.", version=version
            ),
            remedy=UPDATE,
            vendor_text=str(version),
        )
    return kind


def possible_arms(reported: ReportedArm) -> tuple[str, ...]:
    """Return the models that all that a controller says about its arm fits; none where it contradicts itself."""
    name = None if reported.dashboard_name is None else _plain_name(reported.dashboard_name)
    return tuple(
        arm.model
        for arm in arm_types().values()
        if arm.code == reported.type_code
        and arm.runs_on(reported.version)
        and (name is None or name in arm.dashboard_names)
    )


def check_arm(device: str, address: str, expected: str, reported: ReportedArm) -> tuple[str, ...]:
    """Check the model of the cell file; return the other models that it cannot be told from.

    Raises
    ------
    WrongDeviceError
        The controller's arm is surely another one, or one that this driver does not know.
    """
    models = possible_arms(reported)
    if expected in models:
        return tuple(model for model in models if model != expected)
    if not models:
        raise WrongDeviceError(
            device,
            make_message(
                "the controller at {address} reports type code {type_code}, the model {found_model!r} and software "
                "{version}, which fit no arm that this driver knows; the cell file names a {expected_model}.",
                address=address,
                type_code=reported.type_code,
                found_model=reported.dashboard_name or "",
                version=reported.version,
                expected_model=expected,
            ),
            remedy=_READ_THE_LABEL,
        )
    raise WrongDeviceError(
        device,
        make_message(
            "at {address} answers a {found_model} (type code {type_code}, software {version}); the cell file names a "
            "{expected_model}.",
            address=address,
            found_model=list_alternatives(models),
            type_code=reported.type_code,
            version=reported.version,
            expected_model=expected,
        ),
        remedy=_READ_THE_LABEL,
    )


def list_alternatives(models: Sequence[str]) -> str:
    """Return models as a list for people."""
    return " / ".join(models)


def _plain_name(name: str) -> str:
    return name.upper().replace(" ", "").replace("_", "").removesuffix("E")


def _first_version(text: str) -> tuple[int, int]:
    major, minor = text.split(".")
    return int(major), int(minor)
