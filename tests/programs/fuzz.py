"""What every brand's reader must stand: its own files back byte by byte, points changed and nothing else, damage.

A brand brings ``tests/programs/generate_<brand>.py`` (and, for a second kind of file, ``generate_<brand>_<kind>.py``)
with ``generate(seed) -> bytes`` and ``SUFFIX``. A packed format also gives ``unpacked(data)`` and ``packed(text)``;
one whose poses follow from its joints gives ``consistent(file, change)``.

The proof of "only coordinates changed" does not use the reader's spans: both files are cut into numbers and what is
between them. Between them nothing may differ; numbers may differ on the lines of changed positions only, and not
more of them than such a position has coordinates.
"""

import importlib
import pkgutil
import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from types import ModuleType

import numpy as np

import tests.programs
from cellcal.calibration.geometry import Array, exp_rotation, homogeneous_matrix
from cellcal.drivers.program_registry import all_brands
from cellcal.drivers.programs.brands import ProgramBrand
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.programs.positions import (
    CARTESIAN,
    JOINTS,
    UNREAD,
    UNTAUGHT,
    PositionChange,
    Positions,
    ProgramFile,
)
from tests.programs.file_damage import mutate_file

# With the blanks before it, which a wider number takes; never from amid blanks: a line of them would cost its square.
_NUMBER = re.compile(rb"((?<![ \t])[ \t]*+[+-]?+(?:\d++\.?+\d*+|\.\d++)(?:[eE][+-]?+\d++)?+)")
_FLOOR_RAD = 3e-8  # what a rotation matrix of doubles can tell of an angle


@dataclass
class FuzzTally:
    """What a campaign saw."""

    files: int = 0
    positions: int = 0
    refused: int = 0
    located: int = 0  # refused with a line
    changed: int = 0  # files that were read, changed and proved
    slowest_s: float = 0.0  # of processor time, to read or to change one: a busy machine is no hang
    slowest_seed: int = -1
    failures: list[str] = field(default_factory=list)

    def note_duration(self, seconds: float, seed: int) -> None:
        if seconds > self.slowest_s:
            self.slowest_s, self.slowest_seed = seconds, seed


def unchanged_bytes(data: bytes) -> bytes:
    return data


def unchanged_change(_: ProgramFile, change: PositionChange) -> PositionChange:
    return change


@dataclass(frozen=True)
class GeneratorSource:
    """One generator of one brand's files."""

    brand: ProgramBrand
    name: str
    generate: Callable[[int], bytes]
    suffix: str
    unpacked: Callable[[bytes], bytes] = unchanged_bytes
    packed: Callable[[bytes], bytes] = unchanged_bytes
    consistent: Callable[[ProgramFile, PositionChange], PositionChange] = (
        unchanged_change  # where one coordinate follows from others
    )


def generator_sources() -> list[GeneratorSource]:
    """Return every generator of every registered brand; a brand without one is an error."""
    modules = [name for _, name, _ in pkgutil.iter_modules(tests.programs.__path__)]
    found = []
    for brand in all_brands():
        own = [
            n for n in modules if n == f"generate_{brand.brand}" or n.startswith(f"generate_{brand.brand}_")
        ]
        if not own:
            raise LookupError(
                f"{brand.brand} is registered, but tests/programs/generate_{brand.brand}.py is not there"
            )
        found += [_source_of_module(brand, importlib.import_module(f"tests.programs.{name}")) for name in own]
    return found


def _source_of_module(brand: ProgramBrand, module: ModuleType) -> GeneratorSource:
    parts = vars(module)
    return GeneratorSource(
        brand,
        module.__name__.rpartition("generate_")[2],
        parts["generate"],
        parts["SUFFIX"],
        parts.get("unpacked", unchanged_bytes),
        parts.get("packed", unchanged_bytes),
        parts.get("consistent", unchanged_change),
    )


def check_roundtrip(
    brand: ProgramBrand, generate: Callable[[int], bytes], seeds: Iterable[int], *, suffix: str = ""
) -> FuzzTally:
    """Parse and print; the bytes and what the positions declare are checked."""
    tally = FuzzTally()
    name = _file_name(brand, suffix)
    for seed in seeds:
        data = generate(seed)
        start = time.process_time()
        try:
            file = brand.read(name, data)
            if file.to_bytes() != data:
                tally.failures.append(f"seed {seed}: printed is not what was read")
            check_positions(file.positions)
            tally.positions += len(file.positions)
        except Exception as error:
            tally.failures.append(f"seed {seed}: {type(error).__name__}: {error}")
        tally.note_duration(time.process_time() - start, seed)
        tally.files += 1
    return tally


def check_positions(positions: Positions) -> None:
    """Assert that a reader's positions are what `Positions` declares."""
    count = len(positions)
    for values in (positions.kinds, positions.lines, positions.groups, positions.frame_tip, positions.joints):
        assert len(values) == count
    for values in (positions.user_frames, positions.tools, positions.configurations, positions.external):
        assert len(values) == count
    assert len(set(zip(positions.names, positions.groups.tolist(), strict=True))) == count, "a name twice"
    assert positions.frame_tip.shape == (count, 4, 4)
    assert (positions.lines >= 1).all()
    kinds = np.array(positions.kinds, dtype=object)
    own = ~np.isin(kinds, (CARTESIAN, JOINTS, UNTAUGHT, UNREAD))  # a maker's own kind: pulses, shift
    assert np.isnan(positions.joints[own]).all(), "an immovable position holds joints"
    finite = np.isfinite(positions.frame_tip).all(axis=(1, 2))
    assert (finite == (kinds == CARTESIAN)).all(), "a pose where there is none, or none where there is one"
    assert np.isnan(positions.frame_tip[~finite]).all()
    assert np.isfinite(positions.joints[kinds == JOINTS]).any(axis=1).all()
    assert not np.isinf(positions.joints).any()
    unread_axes = np.isinf(positions.external).any(axis=1)
    assert set(np.flatnonzero(unread_axes).tolist()) <= positions.barred.keys(), "axes that are no number"
    assert (positions.resolution_m > 0).all()
    assert (positions.resolution_rad > 0).all()
    rotation = positions.frame_tip[finite, :3, :3]
    assert np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0) < 1e-9


def token_invariant(
    brand: ProgramBrand,
    data: bytes,
    seed: int,
    *,
    suffix: str = "",
    unpacked: Callable[[bytes], bytes] = unchanged_bytes,
    consistent: Callable[[ProgramFile, PositionChange], PositionChange] = unchanged_change,
) -> bool:
    """Change some positions and prove that nothing else changed; False where there is nothing to change.

    Raises
    ------
    AssertionError
        Something else changed, or the new file does not say what was asked.
    ProgramFileError
        The reader refused the file or the change.
    """
    file = brand.read(_file_name(brand, suffix), data)
    return changes_alone(brand, file, data, seed, suffix=suffix, unpacked=unpacked, consistent=consistent)


def changes_alone(
    brand: ProgramBrand,
    file: ProgramFile,
    data: bytes,
    seed: int,
    *,
    suffix: str = "",
    unpacked: Callable[[bytes], bytes] = unchanged_bytes,
    consistent: Callable[[ProgramFile, PositionChange], PositionChange] = unchanged_change,
    took: Callable[[float], None] = lambda _: None,
) -> bool:
    """Change some positions of a file that was read from ``data``; the rest is `token_invariant`'s."""
    change = some_change(file.positions, np.random.default_rng(seed))
    if change is None:
        return False
    change = consistent(file, change)
    start = time.process_time()
    printed = file.with_changes(change).to_bytes()
    took(time.process_time() - start)
    assert file.to_bytes() == data, "changing a file changed the original"
    only_coordinates_differ(unpacked(data), unpacked(printed), file.positions, change)
    check_declared_change(file, brand.read(_file_name(brand, suffix), printed), change)
    return True


def _file_name(brand: ProgramBrand, suffix: str) -> str:
    return f"generated{suffix or brand.suffixes[0]}"


def some_change(positions: Positions, rng: np.random.Generator) -> PositionChange | None:
    """Return a rigid shift of some Cartesian positions and a shift of some joint positions."""
    movable = np.flatnonzero(
        np.array([kind not in (UNTAUGHT, UNREAD) for kind in positions.kinds], dtype=bool)
    )
    if not len(movable):
        return None
    rows = np.sort(rng.choice(movable, size=int(rng.integers(1, len(movable) + 1)), replace=False))
    far, turn = ((0.005, 0.02), (0.5, 2.0), (1e-5, 0.0))[int(rng.integers(3))]
    shift = homogeneous_matrix(exp_rotation(rng.normal(size=3) * turn), rng.normal(size=3) * far)
    joints = positions.joints[rows]
    return PositionChange(
        rows=rows,
        frame_tip=shift @ positions.frame_tip[rows],  # NaN stays NaN
        joints=joints + rng.normal(size=joints.shape) * turn if joints.size else None,
    )


def only_coordinates_differ(
    before: bytes, after: bytes, positions: Positions, change: PositionChange
) -> None:
    """Assert that two files differ in coordinates of the changed positions only, by their tokens."""
    old, new = _NUMBER.split(before), _NUMBER.split(after)  # between the numbers, a number, between, …
    assert old[::2] == new[::2], "something between the numbers changed"
    differing = _lines_of_differing_numbers(before, old, new)
    order = np.argsort(positions.lines, kind="stable")
    starts = positions.lines[order]
    allowed: dict[int, int] = {}
    per_position = 9 + positions.joints.shape[1]
    for row in change.rows:
        line = int(positions.lines[row])
        allowed[line] = allowed.get(line, 0) + per_position
    for line in differing:
        place = int(np.searchsorted(starts, line, side="right")) - 1
        start = int(starts[place]) if place >= 0 else 0
        if start == line and not allowed.get(start):  # the last position of the lines above may end here
            place = int(np.searchsorted(starts, line)) - 1
            start = int(starts[place]) if place >= 0 else 0
        assert allowed.get(start, 0) > 0, f"a number on line {line} changed, which no changed position holds"
        allowed[start] -= 1


def _lines_of_differing_numbers(before: bytes, old: list[bytes], new: list[bytes]) -> list[int]:
    differing = np.array([a != b for a, b in zip(old[1::2], new[1::2], strict=True)], dtype=bool)
    breaks = np.flatnonzero(np.frombuffer(before, dtype=np.uint8) == ord("\n"))
    ends = np.cumsum([len(piece) for piece in old], dtype=np.int64)[1::2] - 1
    return (np.searchsorted(breaks, ends[differing]) + 1).tolist()


def check_declared_change(before: ProgramFile, after: ProgramFile, change: PositionChange) -> None:
    """Assert that changed positions read as asked, within the resolution, and all others as before."""
    old, new = before.positions, after.positions
    for this, that in (
        (old.names, new.names),
        (old.kinds, new.kinds),
        (old.user_frames, new.user_frames),
        (old.tools, new.tools),
        (old.configurations, new.configurations),
        (before.remarks, after.remarks),
        (before.name, after.name),
    ):
        assert this == that
    assert np.array_equal(old.lines, new.lines)
    assert np.array_equal(old.groups, new.groups)
    assert np.array_equal(old.external, new.external, equal_nan=True)
    rest = np.setdiff1d(np.arange(len(old)), change.rows)
    assert np.array_equal(old.frame_tip[rest], new.frame_tip[rest], equal_nan=True), (
        "an untouched pose changed"
    )
    assert np.array_equal(old.joints[rest], new.joints[rest], equal_nan=True), "untouched joints changed"
    if change.frame_tip is not None:
        _poses_agree(new.frame_tip[change.rows], change.frame_tip, old, change)
    if change.joints is not None:
        step = np.maximum(old.resolution_rad, old.resolution_m)[change.rows, None]
        far = np.abs(new.joints[change.rows] - change.joints)
        assert np.array_equal(np.isnan(new.joints[change.rows]), np.isnan(change.joints))
        slack = 1e-12 * np.maximum(1.0, np.abs(change.joints))
        assert not (far > 0.5 * step * (1 + 1e-6) + slack).any(), "joints are not what was asked"


def _poses_agree(
    declared_poses: Array, requested_poses: Array, old: Positions, change: PositionChange
) -> None:
    assert np.array_equal(np.isnan(declared_poses), np.isnan(requested_poses))
    off = np.abs(declared_poses[:, :3, 3] - requested_poses[:, :3, 3])
    size = np.maximum(1.0, np.linalg.norm(requested_poses[:, :3, 3], axis=1))
    allowed = 0.5 * old.resolution_m[change.rows] * (1 + 1e-6) + 1e-12 * size
    assert not (off > allowed[:, None]).any(), "a position is not where it was asked to be"
    chord = np.linalg.norm((declared_poses - requested_poses)[:, :3, :3].reshape(-1, 9), axis=1) / np.sqrt(
        2.0
    )
    assert not (chord > 1.5 * old.resolution_rad[change.rows] + _FLOOR_RAD).any(), (
        "an orientation is not as asked"
    )


def check_mutants(
    brand: ProgramBrand,
    generate: Callable[[int], bytes],
    seeds: Iterable[int],
    *,
    suffix: str = "",
    unpacked: Callable[[bytes], bytes] = unchanged_bytes,
    packed: Callable[[bytes], bytes] = unchanged_bytes,
    consistent: Callable[[ProgramFile, PositionChange], PositionChange] = unchanged_change,
) -> FuzzTally:
    """Damage files: each is refused with a sentence, or read with every byte and every point kept."""
    tally = FuzzTally()
    name = _file_name(brand, suffix)
    base, whole = -1, b""
    for seed in seeds:
        inside = unpacked is not unchanged_bytes and seed % 2 == 0
        if seed // 4 != base:
            base, whole = seed // 4, generate(seed // 4)
        data = packed(mutate_file(unpacked(whole), seed)) if inside else mutate_file(whole, seed)
        start = time.process_time()
        try:
            try:
                file = brand.read(name, data)
            finally:
                tally.note_duration(time.process_time() - start, seed)
            assert file.to_bytes() == data, "printed is not what was read"
            check_positions(file.positions)
            tally.positions += len(file.positions)
            tally.changed += changes_alone(
                brand,
                file,
                data,
                seed,
                suffix=suffix,
                unpacked=unpacked,
                consistent=consistent,
                took=partial(tally.note_duration, seed=seed),
            )
        except ProgramFileError as error:
            tally.refused += 1
            tally.located += error.line > 0
            if error.file != name or not str(error).startswith(name) or error.line < 0:
                tally.failures.append(f"seed {seed}: the error does not say where: {error}")
        except Exception as error:
            tally.failures.append(f"seed {seed}: {type(error).__name__}: {error}")
        tally.files += 1
    return tally


def split_range(count: int, size: int) -> Iterator[range]:
    """Yield ``range(count)`` in pieces, for progress."""
    edges = [*range(0, count, size), count]
    yield from (range(first, last) for first, last in pairwise(edges))
