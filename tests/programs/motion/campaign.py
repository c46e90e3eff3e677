"""Programs of a brand, moved by random transforms, against the interpreter of their motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from cellcal.calibration.arm.kinematics import load_model
from cellcal.drivers.program_registry import brand_named
from cellcal.drivers.programs.brands import DeclaringProgram
from cellcal.drivers.programs.cross_file_uses import BatchDeclarations
from cellcal.drivers.programs.positions import ProgramFile
from cellcal.service.engineering.programs.move import move_transfer
from cellcal.service.engineering.programs.project import Project, ProjectTool
from cellcal.service.engineering.programs.result import LEFT, ProgramResult
from tests.programs.motion.geometry import (
    Array,
    NamedMisses,
    TipTarget,
    moved_wrongly,
    pose_from,
    unnamed_stops,
)

_NO_SINGULARITY = 1e-6
_NOTHING_THERE = "it has no coordinates"  # a variable that the program fills: it names no motion


@dataclass(frozen=True, eq=False)
class MotionLanguage:
    """One brand: its files by their suffixes, what they do, and a robot that goes there."""

    brand: str
    model: str
    generate: Callable[[int], dict[str, str]]  # texts by name
    interpret: Callable[[dict[str, str]], list[TipTarget]]
    tools: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    frames: tuple[tuple[str, Array], ...] = ()


@dataclass
class MotionTally:
    """What a campaign came to."""

    programs: int = 0
    motions: int = 0
    points: int = 0
    changed: int = 0
    left_points: int = 0
    findings: int = 0
    wrong: list[str] = field(default_factory=list)

    def figures_line(self) -> str:
        """Return the figures."""
        return (
            f"{self.programs} programs, {self.motions} motions, {self.points} points: {self.changed} changed, "
            f"{self.left_points} left, {self.findings} findings; wrong and not named: {len(self.wrong)}"
        )


@cache
def _project_of(language: MotionLanguage) -> Project:
    model = load_model(language.model)
    flange = {name: pose_from(Rotation.identity(), np.array(place)) for name, place in language.tools}
    return Project(
        path=Path("project.toml"),
        name="campaign",
        serial="S1",
        nominal=model,
        controller=model,
        factory_known=False,
        identified=None,
        tools={name: ProjectTool(one, one) for name, one in flange.items()},
        frames=dict(language.frames),
        default_tool=None,
        default_frame=None,
        alignment=None,
        shapes=None,
        smallest_sigma=_NO_SINGULARITY,
        master=None,
        programs=(),
    )


def change_of(seed: int) -> Array:
    """Return the motion of the work: none, a shift, a turn about the vertical, or any."""
    rng = np.random.default_rng([seed, 12])
    kind = seed % 4
    turn = np.zeros(3)
    if kind == 1:
        turn = np.array([0.0, 0.0, rng.uniform(-0.4, 0.4)])
    elif kind > 1:
        turn = rng.uniform(-0.2, 0.2, 3)
    return pose_from(Rotation.from_rotvec(turn), rng.uniform(-0.02, 0.02, 3))


def move_programs(language: MotionLanguage, texts: dict[str, str], change: Array) -> Sequence[ProgramResult]:
    """Move the programs of one cell together."""
    brand = brand_named(language.brand)
    files: list[ProgramFile] = [brand.read(name, text.encode("latin-1")) for name, text in texts.items()]
    if brand.tells:
        telling: list[DeclaringProgram] = files  # type: ignore[assignment]  # the brand says so
        across = BatchDeclarations({name: one.declarations for name, one in zip(texts, telling, strict=True)})
        variable_uses = [(one, across.uses_of_file(name)) for name, one in zip(texts, telling, strict=True)]
        files = [
            one if external_uses is None else one.with_external_uses(external_uses)
            for one, external_uses in variable_uses
        ]
    return move_transfer(
        _project_of(language), change, brand.configurations, joints="keep"
    ).transfer_programs(files)


def try_one(language: MotionLanguage, seed: int, tally: MotionTally) -> None:
    """Move one generated cell, and compare what its robot then does."""
    texts, change = language.generate(seed), change_of(seed)
    done = move_programs(language, texts, change)
    after = {name: one.after.to_bytes().decode("latin-1") for name, one in zip(texts, done, strict=True)}
    named = named_of(done)
    old, new = language.interpret(texts), language.interpret(after)
    wrong = [*moved_wrongly(old, new, change, named), *unnamed_stops(old, named)]
    deviates = bool(named.lines)
    if deviates and all(one.is_complete for one in done):
        wrong.append("named, and exit code 0")
    tally.wrong += [f"seed {seed}: {one}" for one in wrong]
    tally.programs += len(texts)
    tally.motions += len(old)
    tally.points += sum(len(one.status) for one in done)
    tally.changed += sum(one.status_counts["changed"] for one in done)
    tally.left_points += sum(one.status_counts[LEFT] for one in done)
    tally.findings += sum(len(one.findings) for one in done)


def named_of(done: Sequence[ProgramResult]) -> NamedMisses:
    """Return the lines and names that results say are left or off."""
    named = NamedMisses()
    main = done[-1]
    for one in done:
        positions = one.before.positions
        for row, status in enumerate(one.status):
            if status == LEFT and one.reason[row] != _NOTHING_THERE:
                named.names.add(positions.names[row].lower())
                if one is main:
                    named.lines.add(int(positions.lines[row]))
        for finding in one.findings:
            named.names.add(finding.point.lower())
            if one is main:
                named.lines.add(finding.line)
    return named
