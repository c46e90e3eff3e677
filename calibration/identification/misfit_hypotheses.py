"""Other ways to understand the same rows: what a person or a program gets wrong about signs, zeros, orders, units."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cellcal.calibration.arm.kinematics import RobotModel
from cellcal.calibration.geometry import Array
from cellcal.calibration.identification.column_options import TypedColumn, columns_option
from cellcal.calibration.identification.observations import Rows
from cellcal.calibration.message import make_message

USUAL_LENGTH_UNITS: Mapping[str, float] = {  # that a file may be in without a word
    "m": 1.0,
    "mm": 1e-3,
    "cm": 1e-2,
    "inch": 25.4e-3,
    "ft": 0.3048,
    "mil": 25.4e-6,
    "um": 1e-6,
}
LENGTH_UNITS: Mapping[str, float] = {**USUAL_LENGTH_UNITS, "0.1mm": 1e-4, "0.01mm": 1e-5}
_QUARTER = np.pi / 2
_FREE_STEP_RAD = float(np.deg2rad(15.0))
_MOST_TURNED = 2  # signs together with another zero
_MOST_PERMUTED = 6  # joints: beyond, only two of them change places
_TURN_DEG = 180.0 / np.pi
_OTHER_ANGLES = (  # the unit that was taken, another one, and what its numbers are to be multiplied with
    ("deg", "gon", 0.9),
    ("rad", "rev", 2.0 * np.pi),
    ("deg", "rad", _TURN_DEG),
    ("rad", "deg", 1.0 / _TURN_DEG),
)
_MIXED_ANGLES = ("deg", "rad")  # which joints of one file may have beside each other
_SLIDE_UNITS = (
    # Taken as mm:
    (1e3, "m"), (10.0, "cm"), (25.4, "inch"),
    # Taken as m:
    (1e-3, "mm"), (1e-2, "cm"), (25.4e-3, "inch"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FileNames:
    """The file's own names of its columns, for cures that can be typed."""

    joints: tuple[str, ...]
    position: tuple[str, ...] = ("X", "Y", "Z")
    length_unit: str = ""  # in which positions or lengths were taken
    angle_unit: str = ""
    joint_coupling: str = (
        ""  # in which the joints were said to be: controller, which empty is too, or geometric
    )
    targets: str = ""  # a column that tells several targets or tools apart
    typed: Mapping[str, TypedColumn] = field(
        default_factory=dict
    )  # how columns are typed, by their names here
    columns: Mapping[str, Array] = field(default_factory=dict)  # that take no part, a number or code a row
    rows: Rows | None = None  # numbers of the rows in the file; None: in the order in which they are

    def as_typed(self, names: Sequence[str]) -> tuple[TypedColumn, ...]:
        """Return columns as ``--columns`` takes them."""
        return tuple(self.typed.get(name, TypedColumn(name)) for name in names)


@dataclass(frozen=True, eq=False)
class JointInterpretation:
    """One way to understand the joints of the rows."""

    kind: str  # sign | home | order | coupling | angle unit | rows | model; empty: as they were read
    parts: int  # how many things are wrong at once
    joints_rad: Array  # (N, n)
    says: str = ""
    cure: str = ""
    zeros_rad: Mapping[int, float] = field(default_factory=dict)
    columns: tuple[TypedColumn, ...] = ()  # with their signs and in their order, if one of these differs
    model: RobotModel | None = None  # another one than was named


def plain_reading(joints_rad: Array) -> JointInterpretation:
    """Return the joints as they were read."""
    return JointInterpretation("", 0, joints_rad)


def joint_readings(
    model: RobotModel, series_rad: Array, rows: Rows, names: FileNames
) -> list[JointInterpretation]:
    """Return every single cause of this model's joints that is known, and some that come together.

    ``series_rad`` are the joints of the whole series, of which ``rows`` are looked at.
    """
    joints_rad = series_rad[rows]
    return [
        *_angle_units(joints_rad, names, turning_joints(model)),
        *_slide_units(joints_rad, names, turning_joints(model)),
        *sign_readings(model, joints_rad, names),
        *_home_readings(joints_rad, names, turning_joints(model)),
        *_turned_homes(model, joints_rad, names),
        *order_readings(joints_rad, names, turning_joints(model)),
        *lagging_readings(series_rad, rows),
    ]


def turning_joints(model: RobotModel) -> NDArray[np.bool_]:
    """Return which joints turn (n,)."""
    return np.ones(model.axis_count, dtype=bool) if model.sliding is None else ~model.sliding


def _slide_units(
    joints_rad: Array, names: FileNames, turning: NDArray[np.bool_]
) -> Iterator[JointInterpretation]:
    """Return the joints that slide in another unit than the one that was taken."""
    if turning.all():
        return
    for factor, unit in _SLIDE_UNITS:
        yield JointInterpretation(
            "slide unit",
            1,
            joints_rad * np.where(turning, 1.0, factor),
            make_message(
                "{joints} is in {unit}",
                joints=join_words([names.joints[i] for i in np.flatnonzero(~turning)]),
                unit=unit,
            ),
            make_message("Say so: `--units slides={unit}`.", unit=unit),
        )


def _angle_units(
    joints_rad: Array, names: FileNames, turning: NDArray[np.bool_]
) -> Iterator[JointInterpretation]:
    if not turning.any():
        return
    for other, unit, factor in _OTHER_ANGLES:
        if names.angle_unit in ("", other):
            factors = np.where(turning, factor, 1.0)
            yield JointInterpretation(
                "angle unit",
                1,
                joints_rad * factors,
                make_message("the joints are in {unit}, not in {other}", unit=unit, other=other),
                f"Say so: `--units joints={unit}`.",
            )
            if unit in _MIXED_ANGLES:
                yield from _mixed_angle_units(joints_rad, names, factors, (unit, other))


def _mixed_angle_units(
    joints_rad: Array, names: FileNames, factors: Array, units: tuple[str, str]
) -> Iterator[JointInterpretation]:
    """Return some of the joints in another unit than the one that was taken."""
    unit, taken = units
    turning = [joint for joint in range(len(factors)) if factors[joint] != 1.0]
    for count in range(1, len(turning)):
        for some in itertools.combinations(turning, count):
            changed = joints_rad.copy()
            changed[:, some] *= factors[list(some)]
            few = some if count <= len(turning) // 2 else tuple(j for j in turning if j not in some)
            one, rest = (unit, taken) if few == some else (taken, unit)
            each = ",".join(unit if joint in some else taken for joint in turning)
            yield JointInterpretation(
                "angle unit",
                1 if len(few) == 1 or _stand_together(few, turning) else 2,
                changed,
                make_message(
                    "{name} is in {one} and the other joints are in {rest}",
                    name=names.joints[few[0]],
                    one=one,
                    rest=rest,
                )
                if len(few) == 1
                else make_message(
                    "{names} are in {one} and the other joints are in {rest}",
                    names=join_words([names.joints[joint] for joint in few]),
                    one=one,
                    rest=rest,
                ),
                f"Say so: `--units joints={each}`.",
            )


def _stand_together(joints: Sequence[int], turning: Sequence[int]) -> bool:
    """Return whether joints are the first or the last of those that turn."""
    count = len(joints)
    return list(joints) in (list(turning[:count]), list(turning[-count:]))


def sign_readings(
    model: RobotModel, joints_rad: Array, names: FileNames, *, most: int | None = None
) -> Iterator[JointInterpretation]:
    """Return every choice of joints, at most so many, that count the other way round."""
    axes = model.axis_count
    for count in range(1, (most or axes) + 1):
        for turned in itertools.combinations(range(axes), count):
            sign = np.ones(axes)
            sign[list(turned)] = -1.0
            plain = names.as_typed(names.joints)
            columns = tuple(column.turned() if i in turned else column for i, column in enumerate(plain))
            which = join_words([names.joints[i] for i in turned])
            yield JointInterpretation(
                "sign",
                count,
                joints_rad * sign,
                make_message("{which} counts the other way round", which=which)
                if count == 1
                else make_message("{which} count the other way round", which=which),
                make_message(
                    "Turn the sign: {columns_option}.", columns_option=columns_option("joints", columns)
                ),
                columns=columns,
            )


def _home_readings(
    joints_rad: Array, names: FileNames, turning: NDArray[np.bool_]
) -> Iterator[JointInterpretation]:
    """Return other zeros: quarter turns of all joints whose zero neither base nor target hides, and of one any."""
    inner = [joint for joint in range(1, joints_rad.shape[1] - 1) if turning[joint]]
    for quarters in itertools.product((0, 1, 2, -1), repeat=len(inner)):
        zeros = {i: quarter * _QUARTER for i, quarter in zip(inner, quarters, strict=True) if quarter}
        if zeros:
            yield home_reading(joints_rad, zeros, names)
    for joint in inner:
        for step in range(-11, 12):
            if step % 6:
                yield home_reading(joints_rad, {joint: step * _FREE_STEP_RAD}, names)


def _turned_homes(model: RobotModel, joints_rad: Array, names: FileNames) -> Iterator[JointInterpretation]:
    """Return one or two signs together with the zero of one joint: angles of a table of rows, not of a controller."""
    turning = turning_joints(model)
    inner = [joint for joint in range(1, joints_rad.shape[1] - 1) if turning[joint]]
    signs = list(sign_readings(model, joints_rad, names, most=_MOST_TURNED))
    for sign, joint, quarter in itertools.product(signs, inner, (1, 2, -1)):
        changed = sign.joints_rad.copy()
        changed[:, joint] += quarter * _QUARTER
        zeros = {joint: quarter * _QUARTER}  # put into words with what the fit adds to them
        yield replace(sign, joints_rad=changed, zeros_rad=zeros, parts=sign.parts + 1)


def home_reading(joints_rad: Array, zeros: Mapping[int, float], names: FileNames) -> JointInterpretation:
    """Return the joints with these angles added."""
    changed = joints_rad.copy()
    for joint, zero in zeros.items():
        changed[:, joint] += zero
    return with_zeros(JointInterpretation("home", 0, changed), zeros, names)


def with_zeros(
    reading: JointInterpretation, zeros: Mapping[int, float], names: FileNames
) -> JointInterpretation:
    """Return a reading told with these zeros (joint: angle to add), beside what else it changes."""
    zero_text = "" if reading.kind == "home" else reading.says
    if not zeros:
        # A reading that was about zeros alone has nothing left to cure.
        cure = "" if reading.kind == "home" else reading.cure
        parts = reading.parts - len(reading.zeros_rad)
        return replace(reading, parts=parts, says=zero_text, cure=cure, zeros_rad=zeros)
    columns = list(reading.columns or names.as_typed(names.joints))
    for joint, zero in zeros.items():
        columns[joint] = columns[joint].with_zero(float(f"{np.rad2deg(zero):.4g}"))
    each = [f"{names.joints[i]} by {np.rad2deg(zero):+.4g} deg" for i, zero in zeros.items()]
    says = (
        make_message("the zero differs, that of {each}", each=each[0])
        if len(each) == 1
        else make_message("the zeros differ, those of {join_words}", join_words=join_words(each))
    )
    cure = make_message(
        "If the file counts from another zero, say so: {columns_option}. If the robot lost its "
        "zero there, master it first.",
        columns_option=columns_option("joints", columns),
    )
    return replace(
        reading,
        parts=reading.parts - len(reading.zeros_rad) + len(zeros),
        says=make_message("{says}, and {and_says}", says=zero_text, and_says=says) if zero_text else says,
        cure=make_message("{own_cure} {further_cure}", own_cure=reading.cure, further_cure=cure)
        if zero_text and not reading.columns
        else cure,
        zeros_rad=zeros,
    )


def order_readings(
    joints_rad: Array, names: FileNames, turning: NDArray[np.bool_]
) -> Iterator[JointInterpretation]:
    """Return the joints in every other order; of seven and more in the simple ones."""
    plain = tuple(range(joints_rad.shape[1]))
    orders = itertools.permutations(plain) if len(plain) <= _MOST_PERMUTED else _simple_orders(plain)
    for order in orders:
        moved = sum(a != b for a, b in zip(order, plain, strict=True))
        if not moved or (turning[list(order)] != turning).any():
            continue
        columns = [names.joints[i] for i in order]
        yield JointInterpretation(
            "order",
            1 if moved == 2 or len(plain) > _MOST_PERMUTED or order == plain[::-1] else moved,
            joints_rad[:, order],
            make_message(
                "the columns of the joints are in another order: {columns}", columns=", ".join(columns)
            ),
            make_message(
                "Name them in this order: {columns_option}.",
                columns_option=columns_option("joints", names.as_typed(columns)),
            ),
            columns=names.as_typed(columns),
        )


def _simple_orders(plain: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return orders in which two joints change places, one stands elsewhere, or all are counted from the other end.

    Controllers show the redundant axis of a seven-axis arm last that stands third in the chain.
    """
    swaps = [_swap_order(plain, *pair) for pair in itertools.combinations(plain, 2)]
    rest = [plain[:at] + plain[at + 1 :] for at in plain]
    moves = [(*rest[at][:to], at, *rest[at][to:]) for at, to in itertools.permutations(plain, 2)]
    return list(dict.fromkeys([*swaps, *moves, plain[::-1]]))


def _swap_order(plain: tuple[int, ...], a: int, b: int) -> tuple[int, ...]:
    order = list(plain)
    order[a], order[b] = order[b], order[a]
    return tuple(order)


def lagging_readings(series_rad: Array, rows: Rows) -> Iterator[JointInterpretation]:
    """Return joints of the rows before or after: two logs that were put side by side one row off."""
    for shift in (1, -1, 2, -2):
        if len(series_rad) > 4 * abs(shift):
            rows_said = f"{abs(shift)} row{'s' if abs(shift) > 1 else ''}"
            yield JointInterpretation(
                "rows",
                1,
                np.roll(series_rad, shift, axis=0)[rows],
                make_message("joints and measured values are {rows_said} apart", rows_said=rows_said),
                make_message("Move the joints {rows_said} down in the file.", rows_said=rows_said)
                if shift > 0
                else make_message("Move the joints {rows_said} up in the file.", rows_said=rows_said),
            )


def join_words(words: Sequence[str]) -> str:
    """Return words as a list that is read: ``J1, J2 and J3``."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
