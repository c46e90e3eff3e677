"""Functions and blocks of a URScript program: which variable a name means at a place, and how far a value lasts.

A name without ``local`` means the global variable where there is one, and else the function's own. A function may
stand inside of another one, as in all programs that PolyScope writes.
"""

import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

from cellcal.drivers.universal_robots.program_files.script_heads import head_at

GLOBAL, UNKNOWN = -1, -2  # in place of a function: a variable of all; one that no function around sets
Variable = tuple[int, str]  # the function whose it is, and its name
Range = tuple[int, int]  # of offsets

_WORD = re.compile(
    r"^[ \t]*+(def|thread|sec|while|if|for|switch|else|elif|case|default|end)\b", re.ASCII | re.MULTILINE
)
_ASSIGNED = re.compile(
    r"^[ \t]*+(?:(global|local)[ \t]++)?+([A-Za-z_]\w*+)[ \t]*+=(?!=)", re.ASCII | re.MULTILINE
)
_BRANCHES = {"else": "if", "elif": "if", "case": "switch", "default": "switch"}
_FUNCTIONS, _LOOPS = ("def", "thread", "sec"), ("while", "for")
_LONGEST_BLANK, _LONGEST_STATEMENT = 200, 2000
_SIGN = re.compile(r"[()\[\]\n]")


@dataclass(frozen=True)
class ScriptFunction:
    """A function or thread."""

    name: str
    parameters: tuple[str, ...]  # "" for one that is not understood
    around: int  # the function in which it stands


@dataclass
class _Block:
    start: int
    end: int
    word: str  # that it begins with; of a branch that of its if or switch
    around: int  # the block in which it stands
    function: int


@dataclass
class ScriptScopes:
    """The functions, blocks and assignments of a script."""

    text: str
    functions: list[ScriptFunction] = field(init=False, default_factory=list)
    _blocks: list[_Block] = field(init=False, default_factory=list)  # in the order of their starts
    _starts: list[int] = field(init=False)
    _globals: set[str] = field(init=False, default_factory=set)
    _locals: set[Variable] = field(init=False, default_factory=set)
    _set_in: set[Variable] = field(init=False, default_factory=set)  # functions that set a name
    _assigned: dict[tuple[Variable, int], list[int]] = field(init=False)  # where, by variable and block

    def __post_init__(self) -> None:
        self._read_blocks()
        self._starts = [one.start for one in self._blocks]
        found = [one for one in _ASSIGNED.finditer(self.text) if not self._is_in_brackets(one.start())]
        for one in found:
            function = self.function_at(one.start(2))
            self._set_in.add((function, one[2]))
            if one[1] == "local":
                self._locals.add((function, one[2]))
            elif one[1] == "global" or function == GLOBAL:
                self._globals.add(one[2])
        for number, header in enumerate(self.functions):
            self._locals.update((number, name) for name in header.parameters if name)
        self._assigned = defaultdict(list)
        for one in found:
            place = one.start(2)
            self._assigned[self.variable_at(one[2], place), self._block_at(place)].append(place)

    def function_at(self, offset: int) -> int:
        """Return the innermost function around an offset."""
        return self._blocks[self._block_at(offset)].function

    def variable_at(self, name: str, offset: int) -> Variable:
        """Return which variable a name means."""
        function = self.function_at(offset)
        while function != GLOBAL:
            if (function, name) in self._locals:
                return function, name
            if name not in self._globals and (function, name) in self._set_in:
                return function, name
            function = self.functions[function].around
        return (GLOBAL if name in self._globals else UNKNOWN), name

    def reach_of(self, variable: Variable, at: int) -> tuple[Range, ...]:
        """Return where, in its function, a variable may hold the value that it gets at an offset.

        Its next assignment in the same branch ends it. Behind a loop or branch it may have been left before.
        """
        block_number = self._block_at(at)
        block = self._blocks[block_number]
        assigned = self._assigned.get((variable, block_number), [at])
        following = bisect_right(assigned, at)
        stop = self._end_of_statement(assigned[following]) if following < len(assigned) else block.end
        ranges = ((at, stop), (block.end, len(self.text)))
        again = self._start_of_repetition(block_number, shared=variable[0] == GLOBAL)
        return ranges if again is None else (*ranges, (again, self._end_of_statement(min(assigned[0], at))))

    def surely_passes(self, place: int, until: int, next_place: float) -> bool:
        """Return whether each way to an offset goes through another above it in its function, and no third below."""
        number, outer = self._block_at(until), self._block_at(place)
        if self._blocks[number].function != self._blocks[outer].function:
            return False
        while number and number != outer:
            block = self._blocks[number]
            if block.word in _LOOPS and next_place < block.end:
                return False
            number = block.around
        return number == outer

    def may_meet(self, marks: Sequence[int], place: int, until: int) -> bool:
        """Return whether a way from an offset to another below it in its function may meet one of the marks.

        A loop around the other alone leads from below it to it again.
        """
        function, inside = self.function_at(until), self._blocks_around(place)
        ranges = [(place, until)]
        for number in self._blocks_around(until) - inside:
            block = self._blocks[number]
            ranges += [(block.start, block.end)] if block.word in _LOOPS else []
        return any(
            begin < mark < end and self.function_at(mark) == function
            for begin, end in ranges
            for mark in marks
        )

    def _blocks_around(self, offset: int) -> set[int]:
        number, found = self._block_at(offset), set[int]()
        while number:
            found.add(number)
            number = self._blocks[number].around
        return found

    def _end_of_statement(self, start: int) -> int:
        deep = 0
        for sign in _SIGN.finditer(self.text, start, start + _LONGEST_STATEMENT):
            deep += (sign[0] in "([") - (sign[0] in ")]")
            if sign[0] == "\n" and deep <= 0:
                return sign.start()
        return min(start + _LONGEST_STATEMENT, len(self.text))

    def _start_of_repetition(self, number: int, *, shared: bool) -> int | None:
        """Return where what runs again begins: the outermost loop of the function, all for a shared variable."""
        found = 0 if shared else None
        function = self._blocks[number].function
        while not shared and number > 0 and self._blocks[number].function == function:
            found = self._blocks[number].start if self._blocks[number].word in _LOOPS else found
            number = self._blocks[number].around
        return found

    def _read_blocks(self) -> None:
        self._blocks.append(_Block(0, len(self.text), "", 0, GLOBAL))
        current = 0
        for found in _WORD.finditer(self.text):
            word, start = found[1], found.start()
            block = self._blocks[current]
            if word == "end" or word in _BRANCHES:
                if not current or block.word != _BRANCHES.get(word, block.word):
                    continue
                block.end, current = start, block.around
                if word == "end":
                    continue
                word = block.word
            function = self._blocks[current].function
            if word in _FUNCTIONS and (head := head_at(self.text, start)) is not None:
                self.functions.append(ScriptFunction(head.name, head.parameters, function))
                function = len(self.functions) - 1
            self._blocks.append(_Block(start, len(self.text), word, current, function))
            current = len(self._blocks) - 1

    def _block_at(self, offset: int) -> int:
        number = max(bisect_right(self._starts, offset) - 1, 0)
        while number and self._blocks[number].end < offset:
            number = self._blocks[number].around
        return number

    def _is_in_brackets(self, offset: int) -> bool:
        """Return whether a line goes on with the arguments of a call, by name."""
        return self.text[max(0, offset - _LONGEST_BLANK) : offset].rstrip()[-1:] in ("(", ",")
