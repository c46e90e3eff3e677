"""Tag points: places that a simulation, a controller or a measuring device knows by name, one path a source."""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import Array, rotation_from_quaternion
from cellcal.calibration.message import make_message

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]

SAME_SIZE = 0.05  # of the spread of one path over the other's: no arm and no workpiece is off by more
_UNITS = (
    (1000.0, "millimetres for metres"),
    (25.4, "millimetres for inches"),
    (39.3700787, "inches for metres"),
    (100.0, "centimetres for metres"),
    (10.0, "millimetres for centimetres"),
)


@dataclass(frozen=True, slots=True)
class TagPath:
    """The tags of one path, as one source has them."""

    source: str  # file, or what the points are
    positions_m: tuple[Triple, ...]
    names: tuple[str, ...] = ()  # empty: tags are told by their order
    quaternions: tuple[Quadruple, ...] = ()  # w, x, y, z; empty: places only
    joints_rad: tuple[tuple[float, ...], ...] = ()  # empty: not told

    def __post_init__(self) -> None:
        count = len(self.positions_m)
        for what, values, width in (
            ("positions", self.positions_m, 3),
            ("quaternions", self.quaternions, 4),
            ("joints", self.joints_rad, len(self.joints_rad[0]) if self.joints_rad else 0),
        ):
            if values and (len(values) != count or any(len(value) != width for value in values)):
                raise CalibrationError(
                    make_message(
                        "{source}: {what} are not the same for every tag", source=self.source, what=what
                    )
                )
            if values and not np.isfinite(np.array(values, dtype=float)).all():
                raise CalibrationError(
                    make_message(
                        "{source}: {what} hold a number that is not finite", source=self.source, what=what
                    )
                )
        if self.names and len(self.names) != count:
            raise CalibrationError(
                make_message(
                    "{source}: {names} names for {count} tags",
                    source=self.source,
                    names=len(self.names),
                    count=count,
                )
            )
        twice = [name for name, times in Counter(self.names).items() if times > 1]
        if twice:
            raise CalibrationError(
                make_message("{source}: two tags are called {name!r}.", source=self.source, name=twice[0]),
                remedy="Give every tag its own name.",
            )

    def __len__(self) -> int:
        return len(self.positions_m)

    def tag_label(self, index: int) -> str:
        """Return what a tag is called: its name, or its number counted from one."""
        return self.names[index] if self.names else str(index + 1)

    def select_tags(self, rows: list[int]) -> "TagPath":
        """Return some of the tags in this order."""
        return TagPath(
            self.source,
            tuple(self.positions_m[row] for row in rows),
            tuple(self.names[row] for row in rows) if self.names else (),
            tuple(self.quaternions[row] for row in rows) if self.quaternions else (),
            tuple(self.joints_rad[row] for row in rows) if self.joints_rad else (),
        )

    def to_positions(self) -> Array:
        """Return (n, 3) [m]."""
        return np.array(self.positions_m, dtype=float).reshape(-1, 3)

    def to_rotations(self) -> Array:
        """Return (n, 3, 3); of a path that has attitudes."""
        return np.array([rotation_from_quaternion(np.array(q)) for q in self.quaternions])


@dataclass(frozen=True, slots=True)
class TagPairs:
    """The same tags in two paths, in the same order."""

    one: TagPath
    other: TagPath
    unpaired: tuple[str, ...]  # tags that only one of them has


def match_tags(one: TagPath, other: TagPath, *, least: int = 3) -> TagPairs:
    """Pair the tags of two paths: by their names where both have them, else by their order.

    Raises
    ------
    DegenerateDataError
        Fewer pairs than ``least``.
    CalibrationError
        Paths without names and of different lengths.
    """
    if not (one.names and other.names):
        if len(one) != len(other):
            raise CalibrationError(
                make_message(
                    "{one} has {count} tags and {other} has {other_count}, and not both name them.",
                    one=one.source,
                    count=len(one),
                    other=other.source,
                    other_count=len(other),
                ),
                remedy="Export both paths with the names of the tags, or the same tags in the same order.",
            )
        pairs = TagPairs(one, other, ())
    else:
        there = {name: row for row, name in enumerate(other.names)}
        rows = [row for row, name in enumerate(one.names) if name in there]
        unpaired = sorted(set(one.names) ^ set(other.names))
        pairs = TagPairs(
            one.select_tags(rows), other.select_tags([there[one.names[row]] for row in rows]), tuple(unpaired)
        )
    if len(pairs.one) < least:
        unpaired_text = (
            make_message("; only in one of them: {names}", names=", ".join(pairs.unpaired[:6]))
            if pairs.unpaired
            else ""
        )
        raise DegenerateDataError(
            make_message(
                "{one} and {other} have {count} tags in common, {least} are needed{unpaired_text}.",
                one=one.source,
                other=other.source,
                count=len(pairs.one),
                least=least,
                unpaired_text=unpaired_text,
            ),
            remedy="Measure more tags, and give the same tag the same name in both files.",
        )
    return pairs


def refuse_other_size(
    one: Array, other: Array, names: tuple[str, str], *, tolerance: float = SAME_SIZE
) -> None:
    """Refuse two sets of the same points (n, 3) whose sizes differ by more than a share: a mix of units, mostly.

    Raises
    ------
    DegenerateDataError
        All points of one set are in one place.
    CalibrationError
        The sizes differ by more than ``tolerance``; the message says which units that would be.
    """
    spreads = [float(np.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=1).mean())) for p in (one, other)]
    if min(spreads) < 1e-6:
        raise DegenerateDataError(
            "all tags of a path are in one place.", remedy="Use tags that are far apart from each other."
        )
    ratio = spreads[0] / spreads[1]
    if abs(math.log(ratio)) <= math.log1p(tolerance):
        return
    large, small = names if ratio > 1.0 else (names[1], names[0])
    size = max(ratio, 1.0 / ratio)
    away, units = min((abs(math.log(size / factor)), unit) for factor, unit in _UNITS)
    units = units if away <= math.log1p(tolerance) else ""
    raise CalibrationError(
        make_message(
            "the tags of {large} are spread {size:.4g} times as wide as those of {small}.",
            large=large,
            size=size,
            small=small,
        ),
        remedy=make_message("This looks like {units}: state the unit of each file.", units=units)
        if units
        else "See that both are the same tags.",
    )
