"""What an alignment is: a fixture in a robot's base, with its uncertainty; and its text file (the chapter's .ALN)."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.errors import CalibrationError
from cellcal.calibration.geometry import Pose
from cellcal.calibration.points.fixture import Covariance6, Triple, UncertainFrame

FORMAT = "alignment 1"


@dataclass(frozen=True, slots=True)
class WirePoints:
    """The alignment points as a wire's lengths show them: all that a fit with another robot's needs of them.

    ``covariance`` is of the points x y z one after the other [m^2], then of the wire: its scale [1], lip [m]
    and slow linearity [m, m].
    """

    wire: str  # who made it and its serial number; two alignments with one wire share what is wrong with it
    found_m: tuple[Triple, ...]  # in the base
    of_wire: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    believed: tuple[float, ...]  # of the wire before the lengths: what is believed must not count twice …
    sigma: tuple[float, ...]  # … and its deviations
    sigma_seat_m: float  # of the adaptor on a point, each time it is put there
    sigma_drawing_m: float  # of the drawing: the same error for every robot


@dataclass(frozen=True, slots=True)
class Alignment(UncertainFrame):
    """One fixture seen from one robot. Never changed; a new measurement is a new alignment."""

    fixture: str
    robot_serial: str
    model: str
    points_in_fixture_m: tuple[Triple, ...]
    base_fixture: Pose
    covariance: Covariance6  # of the right twist (v, w) of base_fixture [m, rad]
    counts_at_zero: tuple[int, ...] = ()  # the mastering it was measured with; empty where none is kept
    points: WirePoints | None = None  # None where no wire measured them


def without_points(alignment: Alignment, keep: Sequence[bool]) -> Alignment:
    """Return an alignment that never found some of its points; its pose is kept as the start of a fit with others."""
    rows = [k for k, is_kept in enumerate(keep) if is_kept]
    points = alignment.points
    if points is not None:
        size = 3 * len(points.found_m)
        index = [*(3 * k + axis for k in rows for axis in range(3)), *range(size, size + len(points.of_wire))]
        covariance = np.array(points.covariance)[np.ix_(index, index)]
        points = replace(
            points,
            found_m=tuple(points.found_m[k] for k in rows),
            covariance=tuple(tuple(float(v) for v in row) for row in covariance),
        )
    drawn = tuple(alignment.points_in_fixture_m[k] for k in rows)
    return replace(alignment, points_in_fixture_m=drawn, points=points)


def alignment_text(alignments: Sequence[Alignment]) -> str:
    """Return alignments as a text file: sorted JSON with exact numbers, which compares line by line."""
    document = {"format": FORMAT, "alignments": [asdict(alignment) for alignment in alignments]}
    return json.dumps(document, sort_keys=True, indent=1, allow_nan=False) + "\n"


def read_alignments(text: str) -> tuple[Alignment, ...]:
    """Read what `alignment_text` wrote.

    Raises
    ------
    CalibrationError
        The text is not an alignment file of this format, or a number in it is not finite.
    """
    try:
        document = parse_json(text)
        if document["format"] != FORMAT:
            raise CalibrationError(f"the format {document['format']!r} is not {FORMAT!r}")
        return tuple(_parse_alignment(entry) for entry in document["alignments"])
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise CalibrationError(
            f"this is no alignment file: {error}", remedy="Export the alignment again."
        ) from error


def _parse_alignment(entry: dict[str, Any]) -> Alignment:
    pose = entry["base_fixture"]
    covariance = np.array(entry["covariance"], dtype=float)
    if covariance.shape != (6, 6) or not np.allclose(covariance, covariance.T, atol=1e-15):
        raise CalibrationError("the covariance of an alignment is symmetric, 6 x 6")
    return Alignment(
        fixture=str(entry["fixture"]),
        robot_serial=str(entry["robot_serial"]),
        model=str(entry["model"]),
        points_in_fixture_m=tuple(_to_triple(point) for point in entry["points_in_fixture_m"]),
        base_fixture=Pose(_to_triple(pose["position_m"]), _to_quadruple(pose["quaternion"])),
        covariance=tuple(tuple(float(v) for v in row) for row in covariance),
        counts_at_zero=tuple(int(count) for count in entry["counts_at_zero"]),
        points=None if entry.get("points") is None else _wire_points(entry["points"]),
    )


def _wire_points(entry: dict[str, Any]) -> WirePoints:
    found = tuple(_to_triple(point) for point in entry["found_m"])
    of_wire, believed, sigma = (
        tuple(float(v) for v in entry[name]) for name in ("of_wire", "believed", "sigma")
    )
    covariance, size = np.array(entry["covariance"], dtype=float), 3 * len(found) + len(of_wire)
    if covariance.shape != (size, size) or not np.allclose(covariance, covariance.T, atol=1e-15):
        raise CalibrationError(
            f"the covariance of {len(found)} points and a wire is symmetric, {size} x {size}"
        )
    if {len(believed), len(sigma)} != {len(of_wire)} or min(sigma) <= 0:
        raise CalibrationError(
            "each number of a wire comes with what was believed and a deviation above zero"
        )
    return WirePoints(
        wire=str(entry["wire"]),
        found_m=found,
        of_wire=of_wire,
        covariance=tuple(tuple(float(v) for v in row) for row in covariance),
        believed=believed,
        sigma=sigma,
        sigma_seat_m=float(entry["sigma_seat_m"]),
        sigma_drawing_m=float(entry["sigma_drawing_m"]),
    )


def _to_triple(values: Sequence[float]) -> Triple:
    x, y, z = (float(v) for v in values)
    return (x, y, z)


def _to_quadruple(values: Sequence[float]) -> tuple[float, float, float, float]:
    w, x, y, z = (float(v) for v in values)
    return (w, x, y, z)


def _refuse_constant(word: str) -> float:
    raise CalibrationError(f"{word} is no number of an alignment")
