"""Tools of generated URScript against an interpreter that runs its branches, loops and functions."""

import random
import re
from dataclasses import dataclass, field

import pytest

from cellcal.drivers.universal_robots.program_files.programs import BRAND

LENGTHS_M = (0.1, 0.1, 0.2, 0.3)  # of tools, the first one more often
FUNCTIONS = ("inner", "outer")
RUNS = 25  # ways through each program
_TOOL = re.compile(r"set_tcp\(p\[0,0,([\d.]+),")


@dataclass
class ScriptWriter:
    """A program that is drawn line by line."""

    rng: random.Random
    lines: list[str] = field(default_factory=list)

    def write_program(self) -> list[str]:
        """Return the lines of two functions, of which one calls the other, and of the program itself."""
        self._write_function("inner", 3, ())
        self._write_function("outer", 3, ("inner",))
        self._write_function("main", 7, FUNCTIONS)
        return [*self.lines, "main()", ""]

    def _write_function(self, name: str, most: int, called: tuple[str, ...]) -> None:
        self.lines.append(f"def {name}():")
        self._write_block(most, called, 0)
        self.lines.append("end")

    def _write_block(self, most: int, called: tuple[str, ...], depth: int) -> None:
        for _ in range(self.rng.randint(1, most)):
            kind = self.rng.choice(("move", "move", "move", "tool", "tool", "if", "while", "call"))
            if kind == "move":
                self.lines.append(f"movel(p[0.3,0.2,0.{len(self.lines):03d},0,3.1,0])")
            elif kind == "tool":
                self.lines.append(f"set_tcp(p[0,0,{self.rng.choice(LENGTHS_M)},0,0,0])")
            elif kind == "call" and called:
                self.lines.append(f"{self.rng.choice(called)}()")
            elif kind in ("if", "while") and depth < 3:
                self.lines.append(f"{kind} on:")
                self._write_block(2, called, depth + 1)
                if kind == "if" and self.rng.random() < 0.5:
                    self.lines.append("else:")
                    self._write_block(2, called, depth + 1)
                self.lines.append("end")


@dataclass
class ScriptRunner:
    """One way through a program; ``seen`` are the lines that it moves in, each with the length of the tool there."""

    lines: list[str]
    rng: random.Random
    tool: float | None = None  # not known before the first one is set
    seen: list[tuple[int, float]] = field(default_factory=list)

    def call(self, name: str) -> None:
        begin = self.lines.index(f"def {name}():") + 1
        self._run(begin, self._end_of_block(begin))

    def _end_of_block(self, at: int, *words: str) -> int:
        """Return where the block that a line stands in ends, or where one of these words stands in it."""
        depth = 0
        while self.lines[at] != "end" or depth:
            if not depth and self.lines[at] in words:
                return at
            depth += self.lines[at].endswith(" on:") - (self.lines[at] == "end")
            at += 1
        return at

    def _run(self, at: int, until: int) -> None:
        while at < until:
            line, end = self.lines[at], at
            if line.startswith("movel") and self.tool is not None:
                self.seen.append((at + 1, self.tool))
            elif found := _TOOL.match(line):
                self.tool = float(found[1])
            elif line.endswith("()"):
                self.call(line.removesuffix("()"))
            elif line.endswith(" on:"):
                end, middle = self._end_of_block(at + 1), self._end_of_block(at + 1, "else:")
                if line.startswith("while"):
                    for _ in range(self.rng.randint(0, 2)):
                        self._run(at + 1, end)
                elif self.rng.random() < 0.5:
                    self._run(at + 1, middle)
                else:
                    self._run(middle + 1, end)
            at = end + 1


def stated_tools(lines: list[str]) -> dict[int, float]:
    """Return by line the length of the tool that each place of a program is said to have."""
    program = BRAND.read("a.script", "\n".join(lines).encode())
    positions = program.positions
    return {
        int(line): round(program.frames.flange_tip[tool].position_m[2], 6)
        for row, (line, tool) in enumerate(zip(positions.lines, positions.tools, strict=True))
        if tool is not None and row not in positions.barred
    }


@pytest.mark.parametrize("block", range(8))
def test_a_place_never_has_another_tool_than_the_program_goes_there_with(block: int) -> None:
    stated_places = 0
    for seed in range(block * 50, block * 50 + 50):
        lines = ScriptWriter(random.Random(seed)).write_program()
        stated = stated_tools(lines)
        stated_places += len(stated)
        for way in range(RUNS):
            runner = ScriptRunner(lines, random.Random(f"{seed} {way}"))
            runner.call("main")
            wrong = [(line, tool) for line, tool in runner.seen if stated.get(line, tool) != tool]
            assert not wrong, "\n".join(lines)
    assert stated_places > 20  # some are certain
