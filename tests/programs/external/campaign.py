"""Generated programs with rails, positioners and standing tools, moved: each point is right, or left and named."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cellcal.drivers.program_registry import brand_named
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from cellcal.service.exit_codes import ExitCode
from tests.programs.external.brands import BRANDS, WrittenPoint, write_abb, write_fanuc, write_kuka
from tests.programs.external.cells import (
    FRAME,
    ON_TABLE,
    TOOL,
    HandAxis,
    HandCell,
    pose_text,
    rail,
    table,
)
from tests.programs.external.hand_geometry import Array, apart, arm, flange_of, pose

_WITHIN_MM, _WITHIN_DEG = 1e-3, 1e-4
_STAND, _WORK = pose((0.42, 0.1, 0.35), (0.3, 0.0, 1.0)), pose((0.02, 0.01, 0.09), (0.0, 0.3, 0.1))
_STATED_TOOLS = {
    "kuka": f"[standing_tools.2.entered]\n{pose_text(_STAND)}[held_work.1.entered]\n{pose_text(_WORK)}",
    "abb": f"[standing_tools.tStand.entered]\n{pose_text(_STAND)}[held_work.wHeld.entered]\n{pose_text(_WORK)}",
}
_DECLARED = (
    "PERS tooldata tStand:=[FALSE,[[420,100,350],[1,0,0,0]],[1,[0,0,20],[1,0,0,0],0,0,0]];",
    'PERS wobjdata wHeld:=[TRUE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];',
)


@dataclass
class ExternalTally:
    """What a campaign came to."""

    programs: int = 0
    points: int = 0
    changed: int = 0
    left_points: int = 0
    wrong: list[str] = field(default_factory=list)

    def figures_line(self) -> str:
        """Return the figures."""
        return (
            f"{self.programs} programs, {self.points} points: {self.changed} moved, {self.left_points} left; "
            f"wrong and not named: {len(self.wrong)}"
        )


@dataclass(frozen=True, eq=False)
class GeneratedCell:
    """A program, the cell as it is, and what the project says of it."""

    true: HandCell
    project: HandCell
    points: list[WrittenPoint]
    text: str
    change: Array
    held: bool = False  # the gripper holds the work


def generate_cell(name: str, seed: int) -> GeneratedCell:
    """Return a cell and its program."""
    rng = np.random.default_rng([seed, len(name), 25])
    change = pose(rng.uniform(-0.015, 0.015, 3), rng.uniform(-0.06, 0.06, 3) * (rng.random() < 0.7))
    if name in _STATED_TOOLS and rng.random() < 0.2:
        return _held_cell(name, rng, change)
    spelling = BRANDS[name]
    is_stated = rng.random() < 0.7
    axes = tuple(_any_axes(name, rng, zeros=is_stated))
    turned = [axis for axis in axes if axis.coordinated and not axis.carries_robot]
    true = HandCell(spelling, axes, turned[-1].frame @ ON_TABLE if turned else FRAME)
    values = [_any_values(axes, rng, still=not is_stated and rng.random() < 0.3) for _ in range(5)]
    in_joints = spelling.in_joints and rng.random() < 0.2
    points = true.points(values, joints=in_joints)
    if name != "yaskawa" and rng.random() < 0.3 and axes:
        row = int(rng.integers(len(points)))
        gone = str(rng.choice([axis.axis for axis in axes]))
        points[row] = replace(points[row], axes={k: v for k, v in points[row].axes.items() if k != gone})
    text = spelling.write(points, spelling.frame)
    if name == "fanuc":
        text = write_fanuc(points, spelling.frame, str(rng.choice(["", "", "COORD", "RTCP", "INC"])))
    stated_axes = axes if is_stated else axes[: int(rng.integers(len(axes) + 1))][:-1]
    unsaid = '[unsaid]\ntool = "tGrip"\n' if name == "abb" else ""
    return GeneratedCell(
        true, replace(true, axes=stated_axes, lines=unsaid), spelling.read(text), text, change
    )


def _held_cell(name: str, rng: np.random.Generator, change: Array) -> GeneratedCell:
    spelling = BRANDS[name]
    axes = (rail(spelling, coordinated=bool(rng.random() < 0.5)),) if rng.random() < 0.5 else ()
    true = HandCell(spelling, axes)
    points = []
    for posture in spelling.postures:
        values = _any_values(axes, rng, still=False)
        stand = (
            _STAND if not true.axes or not axes[0].coordinated else np.linalg.inv(true.base(values)) @ _STAND
        )
        tip = np.linalg.inv(flange_of(arm(spelling.model), np.radians(posture)) @ _WORK) @ stand
        points.append(WrittenPoint(tip, None, values))
    text = (
        write_kuka(points, "2", "#TCP") if name == "kuka" else write_abb(points, "wHeld", "tStand", _DECLARED)
    )
    lines = _STATED_TOOLS[name] if rng.random() < 0.7 else ""
    return GeneratedCell(true, replace(true, lines=lines), spelling.read(text), text, change, held=True)


def _any_axes(name: str, rng: np.random.Generator, *, zeros: bool) -> list[HandAxis]:
    spelling = BRANDS[name]
    found = []
    kind = int(rng.integers(4))
    more = {
        "sign": int(rng.choice([1, -1])),
        "zero": float(np.round(rng.uniform(-60, 60), 2)) if zeros else 0.0,
    }
    if kind in (0, 2, 3):
        found.append(rail(spelling, coordinated=bool(rng.random() < 0.6), **more))
    if kind in (1, 2):
        found.append(table(spelling, coordinated=bool(rng.random() < 0.5), **more))
    return found


def _any_values(axes: Sequence[HandAxis], rng: np.random.Generator, *, still: bool) -> dict[str, float]:
    return {
        axis.axis: 0.0 if still else float(np.round(rng.uniform(-300, 300) * (rng.random() < 0.8), 2))
        for axis in axes
    }


def try_cell(name: str, seed: int, tally: ExternalTally) -> None:
    """Move one generated program, and compare every point."""
    made, spelling = generate_cell(name, seed), BRANDS[name]
    brand = brand_named(spelling.brand)
    with tempfile.TemporaryDirectory() as folder:
        project = made.project.project(Path(folder))
    program = brand.read(spelling.file, made.text.encode())
    result = move_transfer(project, made.change, brand.configurations, joints="move").transfer_programs(
        [program]
    )[0]
    after = spelling.read(result.after.to_bytes().decode())
    rows = [row for row, group in enumerate(program.positions.groups.tolist()) if group == 1]
    tally.programs += 1
    tally.points += len(rows)
    for row, old, new in zip(rows, made.points, after, strict=True):
        is_left = result.status[row] == LEFT
        tally.left_points += is_left
        tally.changed += not is_left
        why = find_wrong_point(made, old, new, left=is_left)
        if why:
            tally.wrong.append(f"seed {seed}, {program.positions.names[row]}: {why}")
    tally.wrong += [f"seed {seed}: {why}" for why in _wrong_codes(result, rows)]


def _wrong_codes(result: ProgramResult, rows: Sequence[int]) -> list[str]:
    left_rows = [row for row in rows if result.status[row] == LEFT]
    found = ["a point is left without a reason" for row in left_rows if not result.reason[row]]
    if left_rows and result.exit_code is not ExitCode.REFUSED:
        found.append("points are left, and the exit code is not 4")
    return found


def find_wrong_point(made: GeneratedCell, old: WrittenPoint, new: WrittenPoint, *, left: bool) -> str:
    """Return what is wrong with a point after the move, "" where nothing is."""
    if new.axes != old.axes:
        return "an external axis changed"
    if left:
        return "" if _same(old, new) else "it is left, and changed"
    old, new = (replace(one, axes={**_still_axes(made), **one.axes}) for one in (old, new))
    missing = [axis.axis for axis in made.true.axes if axis.axis not in old.axes]
    if missing:
        return f"it moved, and nothing says where {missing[0]} stands"
    expected, reached = _tip(made, old), _tip(made, new)
    base, work = made.true.base(old.axes), made.true.work(old.axes)
    if made.held:
        work = np.eye(4)
    expected = np.linalg.inv(base) @ work @ made.change @ np.linalg.inv(work) @ base @ expected
    distance, angle = apart(expected, reached)
    if distance < _WITHIN_MM and angle < _WITHIN_DEG:
        return ""
    return f"it is {distance:.4f} mm and {angle:.5f} deg off"


def _still_axes(made: GeneratedCell) -> dict[str, float]:
    """Return axes that the project does not state and the program never moves: they stand at zero."""
    stated = {axis.axis for axis in made.project.axes}
    moved = {name for point in made.points for name, value in point.axes.items() if value}
    return {axis.axis: 0.0 for axis in made.true.axes if axis.axis not in stated | moved}


def _tip(made: GeneratedCell, point: WrittenPoint) -> Array:
    """Return the tip, or the work in the gripper, in the robot's base."""
    if point.joints is not None:
        return flange_of(arm(made.true.spelling.model), point.joints) @ TOOL
    assert point.tip is not None
    if not made.held:
        return made.true.entered_frame(point.axes) @ point.tip
    carried = [axis for axis in made.true.axes if axis.coordinated]
    stand = np.linalg.inv(made.true.base(point.axes)) @ _STAND if carried else _STAND
    found: Array = stand @ np.linalg.inv(point.tip)
    return found


def _same(old: WrittenPoint, new: WrittenPoint) -> bool:
    for one, other in ((old.tip, new.tip), (old.joints, new.joints)):
        if (one is None) != (other is None) or (one is not None and not np.array_equal(one, other)):  # type: ignore[arg-type]
            return False
    return True
