"""The text of a URScript program, statement by statement: six numbers in brackets, and what is done with them.

Source: Universal Robots, The URScript Programming Language (e-Series); the form of PolyScope's own scripts from
public ones. Nothing is evaluated. A few whole-line forms that fill nearly all of a long program are read with one
expression; every other statement is cut into tokens. Both are linear in the length of the text.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from cellcal.calibration.message import make_message
from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.drivers.universal_robots.program_files.script_calls import MOVES, OpenCall, Role, role_in

NUMBER = r"[+-]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?"
_B = r"[ \t]*+"
SIX = rf"{_B}{NUMBER}{_B}(?:,{_B}{NUMBER}{_B}){{5}}"
_OVER_LINES = r"(?:[ \t\r\n]++|\\\r?\n|\#[^\r\n]*+)*+"  # between numbers of one list, in brackets
SIX_OVER_LINES = rf"{_OVER_LINES}{NUMBER}{_OVER_LINES}(?:,{_OVER_LINES}{NUMBER}{_OVER_LINES}){{5}}"
_CHARACTERS = r"[-+.0-9eE, \t]*+"  # of six numbers, which are read behind this expression
_ARGUMENTS = rf"(?:{_B},{_B}(?:[A-Za-z_]\w*+{_B}={_B})?(?:{NUMBER}|[A-Za-z_]\w*+)(?={_B}[,)]))*+{_B}\)"
_END = rf"{_B}(?:\#[^\r\n]*+)?\r?(?:\n|\Z)"
_MOVE = r"(?:(?:opti)?+move[jl]|movep|servoj|servoc)"
SIX_NUMBERS = re.compile(SIX)
_LINE = re.compile(
    rf"""{_B}(?:
      (?:(?:global|local)[ \t]++)?(?P<name>[A-Za-z_]\w*+){_B}={_B}(?P<kind>p?)\[(?P<six>{_CHARACTERS})\]
    | {_MOVE}\({_B}(?P<move_kind>p?)\[(?P<move_six>{_CHARACTERS})\]{_ARGUMENTS}
    | (?:opti)?+movej\({_B}get_inverse_kin\(
        {_B}(?P<pose>[A-Za-z_]\w*+){_B},{_B}qnear{_B}={_B}(?P<near>[A-Za-z_]\w*+){_B}\){_ARGUMENTS}
    | {_MOVE}\({_B}(?P<target>[A-Za-z_]\w*+){_ARGUMENTS}
    | \${_B}\d++(?:{_B}"[^"\r\n]*+")*+
    | )
    {_END}""",
    re.ASCII | re.VERBOSE,
)
_BLANKS = r"(?:[ \t\r]++|\\\r?\n|\#[^\r\n]*+)*+"  # and comments, and line feeds that the language skips
_TOKEN = re.compile(
    rf"""{_BLANKS}(?:(?P<line>\n)
    |(?P<text>"[^"\r\n]*+"|'[^'\r\n]*+')
    |(?P<six>p?\[{SIX_OVER_LINES}\])
    |(?P<number>(?:0[xX][0-9a-fA-F]++|\d++(?:\.\d*+)?(?:[eE][+-]?\d++)?|\.\d++(?:[eE][+-]?\d++)?)(?![\w.]))
    |(?P<name>[A-Za-z_]\w*+)
    |(?P<open>[(\[{{])
    |(?P<close>[)\]}}])
    |(?P<sign>[=,.:'\\]|[-+*/%<>!;$&|^~?@]++))""",
    re.ASCII | re.VERBOSE,
)
_NUMBER_LIKE = re.compile(rf"{_BLANKS}(?P<spoiled>[\d.][\w.]*)", re.ASCII)  # and no number
_AFTER_BLANKS = re.compile(rf"{_BLANKS}(?P<rest>.)", re.DOTALL)
_BAD = re.compile(r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f]|\r(?!\n)")
_FINE = bytes([9, 10, 13, *range(32, 127), *range(128, 256)])
_BLOCKS = ("def", "thread", "sec", "while", "if", "for", "switch")
_DEEPEST = 100  # no program opens so many brackets in one statement
_NO_NUMBER = re.compile(r"\b(?:nan|inf)\b", re.IGNORECASE)
_PAIRS = {"(": ")", "[": "]", "{": "}"}
_NO_SCRIPT = "It is no URScript, or damaged; correct this line."
_ENCODING = "Save it as plain text, UTF-8 without zeros, with line feeds; or fetch it from the robot again."


class ScriptLiteral(NamedTuple):
    """Six numbers in brackets."""

    start: int  # of the text between the brackets
    end: int
    is_pose: bool
    role: Role
    call: int  # where the call begins that it is an argument of; 0 for none
    name: str  # that it is assigned to, or of the frame it is in


class ElementSet(NamedTuple):
    """One element of a variable gets a value."""

    name: str
    offset: int  # where the name stands


@dataclass(slots=True)
class ScriptStatements:
    """The statements of a program that concern poses and postures."""

    literals: list[ScriptLiteral] = field(default_factory=list)
    uses: dict[str, list[tuple[int, Role, str]]] = field(
        default_factory=dict
    )  # offset, role, frame or function
    assigned: dict[str, int] = field(default_factory=dict)  # how often anything else is put into a variable
    elements: list[ElementSet] = field(default_factory=list)
    calls: dict[str, list[int]] = field(default_factory=dict)  # offsets of calls, by function
    computed: list[tuple[int, str]] = field(default_factory=list)  # moves whose target is an expression
    broken: list[tuple[int, str]] = field(default_factory=list)  # poses with what is no number; the variable
    computed_near: list[int] = field(default_factory=list)  # where joints that qnear gets are expressions

    def note_use(self, name: str, offset: int, role: Role, where: str = "") -> None:
        uses = self.uses.get(name)
        if uses is None:
            self.uses[name] = [(offset, role, where)]
        else:
            uses.append((offset, role, where))


class Token(NamedTuple):
    """One token that is neither blank nor comment."""

    kind: str
    text: str
    start: int
    end: int


class ScriptText:
    """The text with its name, for messages."""

    def __init__(self, file: str, text: str, written: str = "") -> None:
        self.file, self.text, self.written = file, text, written or text  # the last: errors tell its lines
        self.depth: list[tuple[str, int]] = []  # blocks that are open
        self.blocks: list[tuple[int, int]] = []  # those that have ended, and branches of an if: from, to

    def error_at(self, offset: int, what: str, remedy: str) -> ProgramFileError:
        """Return the error for something at an offset."""
        line = self.written.count("\n", 0, offset) + 1
        column = offset - (self.written.rfind("\n", 0, offset) + 1) + 1
        return ProgramFileError(self.file, what, line=line, column=column, remedy=remedy)

    def read_statements(self) -> ScriptStatements:
        """Read the whole text.

        Raises
        ------
        ProgramFileError
            Text that is not URScript, or damaged: brackets, strings, numbers, blocks.
        """
        text, found = self.text, ScriptStatements()
        self._look_for_damage()
        at, end = (3 if text.startswith("\xef\xbb\xbf") else 0), len(text)
        while at < end:
            line = _LINE.match(text, at)
            at = (
                line.end()
                if line and _take_line(line, found)
                else _StatementReader(self, found).read_statement(at)
            )
        if self.depth:
            word, where = self.depth[-1]
            raise self.error_at(
                where,
                make_message("this {word} has no end.", word=word),
                "The file is cut short or damaged; fetch it again.",
            )
        return found

    def _look_for_damage(self) -> None:
        data = self.text.encode("latin-1")
        if data.translate(None, _FINE) or data.count(b"\r") != data.count(b"\r\n"):
            bad = _BAD.search(self.text)
            where, what = (bad.start(), bad[0]) if bad else (0, "")
            raise self.error_at(
                where, make_message("there is a control character {what!r}.", what=what), _ENCODING
            )

    def iterate_tokens(self, at: int) -> Iterator[Token]:
        """Yield the tokens from an offset on, blanks and comments left out; at the end an empty line."""
        text, end = self.text, len(self.text)
        while found := _TOKEN.match(text, at) or _NUMBER_LIKE.match(text, at):
            kind = found.lastgroup or ""
            start, at = found.span(kind)
            yield Token(kind, text[start:at], start, at)
        blank_match = _AFTER_BLANKS.match(text, at)
        if blank_match is not None:
            at = blank_match.start("rest")
            raise self.error_at(at, self.what_is_wrong(at), _NO_SCRIPT)
        yield Token("line", "", end, end)

    def what_is_wrong(self, at: int) -> str:
        piece = re.compile(r"[\w.]{1,24}|.", re.ASCII | re.DOTALL).match(self.text, at)
        shown = piece[0] if piece else ""
        if shown == '"':
            return "a text has no closing quotation mark."
        if shown[:1].isdigit() or shown[:1] == ".":
            return make_message("{spot_text!r} is no number.", spot_text=shown)
        return make_message("{shown!r} is no part of a statement.", shown=shown)

    def count_block(self, word: str, offset: int) -> None:
        """Count a block's beginning or end."""
        if word != "end":
            self.depth.append((word, offset))
        elif self.depth:
            self.blocks.append((self.depth.pop()[1], offset))
        else:
            raise self.error_at(
                offset, "this end belongs to nothing.", "Lines are missing above it, or it is one too many."
            )


def _take_line(line: re.Match[str], found: ScriptStatements) -> bool:
    """Take what a line of one of the usual forms says; False where it is none of them after all."""
    which = line.lastgroup
    if which in ("six", "move_six"):
        start, end = line.span(which)
        if SIX_NUMBERS.fullmatch(line.string, start, end) is None:
            return False  # one is computed, or none: the tokens tell which place that is
        if which == "six":
            found.literals.append(ScriptLiteral(start, end, line["kind"] == "p", "value", 0, line["name"]))
        else:
            found.literals.append(ScriptLiteral(start, end, line["move_kind"] == "p", "target", 0, ""))
    elif which == "near":
        found.note_use(line["pose"], line.start("pose"), "target")
        found.note_use(line["near"], line.start("near"), "near")
    elif which == "target":
        found.note_use(line["target"], line.start("target"), "target")
    return True


class _StatementReader:
    """One statement, from its first token to the end of its line, or of the line where its brackets close."""

    def __init__(self, source: ScriptText, found: ScriptStatements) -> None:
        self.source = source
        self.found = found
        self.stack: list[OpenCall] = []
        self.before: Token | None = None  # the token before the waiting one
        self.waiting: Token | None = None  # a name or six numbers, until it is known what follows
        self.words: list[str] = []  # the words it begins with
        self.assigns = ""  # the variable that something is put into
        self.value = False  # what is put into it is six numbers and nothing else
        self.block: tuple[str, int] | None = None
        self.begins: Token | None = None  # the name that it begins with

    def read_statement(self, at: int) -> int:
        """Read it and return where the next one starts."""
        for token in self.source.iterate_tokens(at):
            if token.kind == "line" and token.text and self.stack:
                continue  # within brackets the statement goes on
            if self.waiting is not None:
                self._settle_item(self.waiting, token)
                self.before, self.waiting = self.waiting, None
            if token.kind == "line":
                self._finish_statement()
                return token.end
            self._take_token(token)
        raise AssertionError("the last token is the end of a line")

    def _take_token(self, token: Token) -> None:
        if token.kind in ("name", "six"):
            self.waiting = token
            return
        self._look_for_spoiled(token)
        if token.kind == "open":
            self._open_bracket(token)
        elif token.kind == "close":
            self._close_bracket(token)
        elif token.text == "=" and self._sets_an_element(token) and self.begins is not None:
            self.found.elements.append(ElementSet(self.begins.text, self.begins.start))
        elif token.text == "," and self.stack:
            self.stack[-1].next_argument()
        elif token.text == ":" and not self.stack and self.words:
            self._begin_block()
            return
        self.before = token

    def _begin_block(self) -> None:
        """Begin the statement that may stand behind a block's colon in the same line."""
        if self.block:
            self.source.count_block(*self.block)
        self.before, self.block, self.begins, self.words = None, None, None, []

    def _look_for_spoiled(self, token: Token) -> None:
        if self.stack and self.stack[-1].opens == "[":
            self.stack[-1].look_for_spoiled(token.kind, token.text, self.before.kind if self.before else "")
        elif token.kind == "spoiled":
            raise self.source.error_at(token.start, self.source.what_is_wrong(token.start), _NO_SCRIPT)

    def _sets_an_element(self, token: Token) -> bool:
        """Return whether an assignment's sign stands behind the index of the name that the statement begins with."""
        before = None if self.source.text.startswith("=", token.end) else self.before  # == compares
        return not self.stack and before is not None and before.text in ("]", "+", "-")

    def _settle_item(self, item: Token, after: Token) -> None:
        """Decide what a name or six numbers are, when what follows is known."""
        if item.kind == "six":
            self._take_literal(item, after)
        elif after.text == "=" and self.stack and self.stack[-1].opens == "(":
            self.stack[-1].keyword = item.text
        elif not self.stack and (self.before is None or (self.before.kind == "name" and self.words)):
            self._take_word(item, after)
        elif after.text not in ("(", "["):
            self._take_name(item, after)
        elif after.text == "[" and item.text != "p":
            self.found.note_use(item.text, item.start, "other", "[")

    def _take_word(self, item: Token, after: Token) -> None:
        self.words.append(item.text)
        if after.text == "[":
            self.begins = item
        if after.text == "=":
            self.assigns = item.text
        if len(self.words) > 1:
            return
        if item.text in _BLOCKS:
            self.block = (item.text, item.start)
        elif item.text == "end":
            self.source.count_block("end", item.start)
        elif item.text in ("else", "elif") and self.source.depth:
            self.source.blocks.append((self.source.depth[-1][1], item.start))

    def _take_name(self, item: Token, after: Token) -> None:
        call = self.stack[-1] if self.stack else None
        role, where = role_in(self.stack)
        if call is None or not self._is_whole_argument(after):
            role = "other"
        elif call.argument == 0 and not call.keyword:
            call.first_name = item.text
        if call is not None and role in ("target", "in_frame"):
            call.reached.add(call.argument)
        self.found.note_use(item.text, item.start, role, where)

    def _take_literal(self, item: Token, after: Token) -> None:
        before = self.before
        if before is not None and before.end == item.start and before.kind in ("name", "close"):
            return  # an index, not a list
        is_pose = item.text[0] == "p"
        role, where = role_in(self.stack)
        name = where if role == "in_frame" else ""
        call = self.stack[-1] if self.stack else None
        if (
            call is None
            and self.assigns
            and before is not None
            and before.text == "="
            and after.kind == "line"
        ):
            role, name, self.value = "value", self.assigns, True
        elif call is None or not self._is_whole_argument(after):
            role = "other"
        if call is not None and role in ("target", "in_frame"):
            call.reached.add(call.argument)
        number = call.offset if call is not None else 0
        self.found.literals.append(
            ScriptLiteral(item.start + 1 + is_pose, item.end - 1, is_pose, role, number, name)
        )

    def _is_whole_argument(self, after: Token) -> bool:
        """Return whether the waiting item is a whole argument."""
        return self.before is not None and self.before.text in ("(", ",", "=") and after.text in (",", ")")

    def _open_bracket(self, token: Token) -> None:
        before = self.before
        called = before is not None and before.kind == "name" and before.end == token.start
        function = before.text if called and before is not None else ""
        if token.text != "(" and function != "p":
            function = ""
        if token.text == "(" and function:
            self.found.calls.setdefault(function, []).append(token.start)
        if len(self.stack) == _DEEPEST:
            cure = "The line is damaged; fetch the file again."
            raise self.source.error_at(
                token.start, make_message("more than {deepest} brackets are open.", deepest=_DEEPEST), cure
            )
        indexed = before is not None and before.end == token.start and before.kind in ("name", "close")
        index = token.text == "[" and indexed and not function
        self.stack.append(OpenCall(token.text, function, token.start, index=index))

    def _close_bracket(self, token: Token) -> None:
        if not self.stack or _PAIRS[self.stack[-1].opens] != token.text:
            cure = "A bracket is missing, or one too many; correct this line."
            raise self.source.error_at(
                token.start, make_message("{token_text!r} closes nothing.", token_text=token.text), cure
            )
        call = self.stack.pop()
        outer = role_in(self.stack)[0]
        posed = call.opens == "[" and not call.index
        if posed and (call.function == "p" or outer == "target") and self._is_broken(call, token):
            self.found.broken.append((call.offset, "" if self.stack else self.assigns))
            if self.stack:
                self.stack[-1].reached.add(self.stack[-1].argument)  # not computed: its place is named
        if posed and outer == "near":
            self.found.computed_near.append(call.offset)
        if call.function in ("pose_trans", "get_inverse_kin") and call.reached and outer == "target":
            self.stack[-1].reached.add(self.stack[-1].argument)
        elif call.function in MOVES and not call.is_understood:
            self.found.computed.append((call.offset, call.function))

    def _is_broken(self, call: OpenCall, close: Token) -> bool:
        """Return whether a pose or a posture has not six numbers, or one that a computation spoiled."""
        text, six = self.source.text, call.argument == 5 and not call.spoiled
        return not six or _NO_NUMBER.search(text, call.offset, close.start) is not None

    def _finish_statement(self) -> None:
        if self.stack:
            opened = self.stack[-1]
            cure = "The statement is cut short; correct it, or fetch the file again."
            raise self.source.error_at(
                opened.offset, make_message("{opens!r} is not closed.", opens=opened.opens), cure
            )
        if self.assigns and not self.value:
            self.found.assigned[self.assigns] = self.found.assigned.get(self.assigns, 0) + 1
