"""Targets that a RAPID program passes to routines, whose moves to a parameter go to what is passed."""

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field

from cellcal.drivers.abb.program_files.displacements import WORDS
from cellcal.drivers.abb.program_files.instructions import MOVES
from cellcal.drivers.abb.program_files.literals import (
    INDEX,
    NAME,
    NAMED_ARGUMENT,
    NOT_CODE,
    OPENED,
    OPTION,
    W,
    decode_name,
)
from cellcal.drivers.abb.program_files.measured_places import measured_name
from cellcal.drivers.abb.program_files.reading_routines import is_of_robotware, only_reads
from cellcal.drivers.abb.program_files.target_uses import TargetUses
from cellcal.drivers.programs.routine_calls import (
    UNCERTAIN,
    ParameterUse,
    RoutineCall,
    RoutineParameter,
    RoutineTargets,
)

_LATE = rf'%{W}(?:"(?P<late>(?:[^"\n]++|"")*+)"|[^%";\n]++)*+%'  # the name of a routine as a value
_CODE = re.compile(rf'{NOT_CODE}|{_LATE}|Move[LJC] [^;!"(]*+;|{NAME}|;', re.ASCII)
_ARGUMENT = re.compile(rf'{NOT_CODE}|[\[\](){{}},;\\]|[^\[\](){{}},;!"\\]++')
_PARAMETER = re.compile(
    rf"(?P<before>[,\\|]|\A){W}(?P<mode>(?:INOUT|VAR|PERS|REF|ALIAS)\b)?+{W}(?P<type>[A-Za-z]\w*+){W}(?P<name>{NAME})"
    rf"{W}(?:\{{[^{{}}]*+\}}{W})?+(?=[,\\|]|\Z)",
    re.ASCII | re.IGNORECASE,
)
_PLACE = re.compile(  # a target, or what a function makes of one that is its first argument
    rf"{W}(?:{NAME}{W}\({W}){{0,4}}+({NAME}){W}(?:\{{([^{{}};]*+)\}}{W})?+(?:[,)][^;]*+)?+",
    re.ASCII | re.IGNORECASE,
)
_COMPONENT = re.compile(rf"{W}({NAME}){W}(?:\{{[^{{}};]*+\}}{W})?+\.[^;,(]*+", re.ASCII)
_RECORD = re.compile(  # a component of a record of the program's own, which may be a target
    rf"{W}({NAME}){W}(?:\{{([^{{}};]*+)\}}{W})?+(?:\.{W}(?!(?:trans|rot|robconf|extax|robax)\b)\w++{W}(?:\{{[^{{}};]*+\}}{W})?+){{1,4}}+",
    re.ASCII | re.IGNORECASE,
)
_REFERENCE = re.compile(  # data as a whole, or what places them; an expression is passed by its value
    rf"{W}({NAME}){W}(?:\{{[^{{}};]*+\}}{W})?+(?:\.{W}(?:[uot]frame|robhold|ufprog|ufmec)\b[\w.\s]*+)?+",
    re.ASCII | re.IGNORECASE,
)
_HEADER = re.compile(rf"{W}\((?:[^()!]++|![^\n]*+){{0,1000}}+\)", re.ASCII)
_COMMENT = re.compile(r"![^\n]*+")
_PASSES = re.compile(rf"{W}[\\A-Za-z\x80-\xff\d\"\[+-]", re.ASCII)
_NEXT_NAME = re.compile(rf"{W}({NAME})", re.ASCII)
_LEADING = frozenset(  # a statement follows
    ("then", "else", "do", "error", "undo", "endif", "endfor", "endwhile", "endtest")
)
_FLOW = frozenset(
    ("if", "elseif", "while", "for", "test", "case", "goto", "return")
)  # no routine is called so
_NO_CALLS = _LEADING | _FLOW | MOVES.keys()
_WORK_OBJECT = "wobj"  # the option that names one
_COMPUTING_JOINTS = frozenset(("calcjointt",))  # functions of the language, for which no work object is wobj0
TYPES_WITHOUT_TARGETS = frozenset(  # types of the language that hold no target; a record of the program's own may
    ("num", "dnum", "bool", "byte", "string", "pos", "orient", "pose", "confdata", "extjoint", "robjoint",
     "jointtarget", "tooldata", "wobjdata", "loaddata", "speeddata", "zonedata", "stoppointdata", "clock", "intnum",
     "iodev", "identno", "signaldi", "signaldo", "signalai", "signalao", "signalgi", "signalgo", "mecunit", "errnum",
     "errstr", "errdomain", "errtype", "progdisp", "triggdata", "listitem", "buttondata", "switch", "rawbytes",
     "socketdev", "socketstatus", "taskid", "tasks", "syncident", "corrdescr", "trapdata", "tunetype", "shapedata",
     "wzstationary", "wztemporary", "datapos", "dir", "motsetdata", "dionum", "opnum", "symnum", "tpnum",
     "aiotrigg", "restartdata", "inposdata", "loadsession", "paridnum")
)  # fmt: skip
_ANY_ROUTINE = "%"  # in place of the name of one that the program chooses while it runs
_MOST_TOKENS = 400
_MOST_ROUNDS = 20


@dataclass
class RoutineParameters:
    """The parameters of a file's routines."""

    of_scope: dict[str, list[RoutineParameter]] = field(default_factory=dict)
    first_scopes: dict[str, str] = field(default_factory=dict)  # by routine: the first scope of its name
    routines: set[str] = field(default_factory=set)  # all of the file, in small letters
    written: set[tuple[str, str]] = field(
        default_factory=set
    )  # scope, name: a routine gives a value, and its caller's data gets it

    tools: set[tuple[str, str]] = field(default_factory=set)  # scope, name: parameters that are a tool
    passing_on: set[str] = field(default_factory=set)  # scopes that pass parameters to other files' routines

    def declare_routine(self, scope: str, parameters: str) -> list[str]:
        """Note a routine's parameters; return their names as written."""
        found = list(_PARAMETER.finditer(parameters))
        self.first_scopes.setdefault(scope.partition("/")[2], scope)
        self.of_scope[scope] = [
            RoutineParameter(
                decode_name(one["name"]).lower(),
                one["before"] in ("\\", "|"),
                one["type"].lower() not in TYPES_WITHOUT_TARGETS,
                one["mode"] is None,
            )
            for one in found
        ]
        names = [decode_name(one["name"]) for one in found]
        self.tools |= {
            (scope, name.lower())
            for one, name in zip(found, names, strict=True)
            if one["type"].lower() == "tooldata"
        }
        return names

    def to_targets(self, uses: TargetUses) -> dict[str, RoutineTargets]:
        """Return by routine what it does to targets, and to other data, that other files pass."""
        found = {}
        for scope, parameters in self.of_scope.items():
            of_target = {
                one.name: some
                for one in parameters
                if one.is_target and (some := uses.uses_of_parameter(scope, one.name))
            }
            written = frozenset(name for where, name in self.written if where == scope)
            if of_target or written or scope in self.passing_on:
                found[scope.partition("/")[2]] = RoutineTargets(tuple(parameters), of_target, written)
        return found


def pass_targets(
    uses: TargetUses,
    parameters: RoutineParameters,
    calls: Sequence[RoutineCall],
    kept: Set[tuple[str, str]],
    tools: Set[str],
) -> None:
    """Count the moves of routines to their parameters for the targets that calls pass.

    ``kept`` are names and scopes of parameters that a routine gives another value: what is passed by value stays.
    ``tools`` are names that are a tool's, in small letters.
    """
    called = [(call, scope) for call in calls if (scope := _routine_scope(parameters, call))]
    uses.calls_of_other_files = _calls_of_other_files(
        uses, parameters, [_with_tool(uses, parameters, one, tools) for one in calls]
    )
    for _ in range(_MOST_ROUNDS):  # a routine may pass its parameter on
        changes = [_pass_call(uses, parameters, one, kept) for one in called]
        if not any(changes):
            break
    for call in calls:
        for name in (*call.arguments, *call.options.values()) if call.routine == _ANY_ROUTINE else ():
            if uses.rows_of(name, call.scope):
                uses.add_uses(call.scope, name, {(None, None)})
    uses.note_copied_parameters()
    uses.forget_parameters()


def _with_tool(
    uses: TargetUses, parameters: RoutineParameters, call: RoutineCall, tools: Set[str]
) -> RoutineCall:
    """Return a call that states a tool where what stands before its work object is one, and else may be one."""
    if call.stated is None:
        return call
    tool, frame = call.stated[:2]
    key = call.scope, (tool or "").lower()
    if frame is not None and (call.scope, frame.lower()) in uses.parameters:
        frame = None  # as the caller says
    if key in parameters.tools:
        tool = None
    elif key in uses.parameters or uses.rows_of(key[1], call.scope):
        tool = UNCERTAIN
    elif call.routine not in _COMPUTING_JOINTS and key[1] not in tools:
        tool = UNCERTAIN + (tool or "")
    return call._replace(stated=ParameterUse(tool, frame))


def _calls_of_other_files(
    uses: TargetUses, parameters: RoutineParameters, calls: Sequence[RoutineCall]
) -> list[RoutineCall]:
    """Return calls of other files' routines, and of own ones that pass on what they get to such."""
    waiting = list(calls)
    found: list[RoutineCall] = []
    while True:
        reaching = {scope.partition("/")[2] for scope in parameters.passing_on}
        some = [one for one in waiting if one.routine not in parameters.routines or one.routine in reaching]
        if not some:
            return found
        taken = set(map(id, some))
        waiting = [one for one in waiting if id(one) not in taken]
        new = [seen_call for one in some if (seen_call := _call_for_other_files(uses, one)) is not None]
        alike = {(one.scope, one.routine, one.arguments): one for one in some}
        new += [copied for one in alike.values() for copied in _calls_with_sources(uses, one)]
        parameters.passing_on |= {one.scope for one in new if one.passes_on}
        found += new


def _call_for_other_files(uses: TargetUses, call: RoutineCall) -> RoutineCall | None:
    """Return a call with what other files see of its arguments; None for one of nothing."""

    def name_for_other_files(name: str) -> str:
        return uses.key_for_other_files(name, call.scope) if name else ""

    arguments, parts = (tuple(map(name_for_other_files, some)) for some in (call.arguments, call.parts))
    options = {option: name_for_other_files(name) for option, name in call.options.items()}
    references = tuple(
        name_for_other_files(name)
        for name in (() if only_reads(call) else call.references)
        if not uses.rows_of(name, call.scope)
    )
    if not any((*arguments, *parts, *options.values(), *references)):
        return None
    stated = (
        None if call.stated is None or call.routine in WORDS else uses.seen_by_other_files(*call.stated[:2])
    )
    return call._replace(
        arguments=arguments, parts=parts, options=options, stated=stated, references=references
    )


def _calls_with_sources(uses: TargetUses, call: RoutineCall) -> Iterator[RoutineCall]:
    """Yield a call, as other files see it, as if it passed the targets themselves of which it passes copies."""
    if not uses.copied:  # as in many
        return
    sources = [uses.copied_into(name, call.scope) if name else [] for name in call.arguments]
    if any(sources):
        names = tuple(uses.key_for_other_files(each, call.scope) if each else "" for each in call.arguments)
        yield from call._replace(arguments=names).with_sources(sources)


def _routine_scope(parameters: RoutineParameters, call: RoutineCall) -> str:
    """Return the scope of the routine that a call means: its own module's, then another's; "" for none."""
    own = f"{call.scope.partition('/')[0]}/{call.routine}"
    return own if own in parameters.of_scope else parameters.first_scopes.get(call.routine, "")


def _pass_call(
    uses: TargetUses,
    parameters: RoutineParameters,
    one: tuple[RoutineCall, str],
    safe_names: Set[tuple[str, str]],
) -> bool:
    """Take up what one call passes; tell whether that is more than was known."""
    call, scope = one
    its, more = parameters.of_scope[scope], False
    for parameter in its:
        passed = call.argument_for(its, parameter.name) if parameter.is_target else ""
        if not passed:
            continue
        some = {
            (_frame_passed(uses, tool, (call, its)), _frame_passed(uses, frame, (call, its)))
            for tool, frame in uses.uses_in(scope, parameter.name)
        }
        uses.note_passed(call.scope, passed, (scope, parameter.name))
        more |= uses.add_uses(call.scope, passed, some)
        if not (parameter.by_value and (parameter.name, scope) in safe_names):
            more |= uses.add_rows(scope, parameter.name, uses.rows_of(passed, call.scope))
    return more


def _frame_passed(
    uses: TargetUses, name: str | None, called: tuple[RoutineCall, Sequence[RoutineParameter]]
) -> str | None:
    """Return the tool or work object that a routine uses when it is called so; None where it cannot be told."""
    call, parameters = called
    passed = call.frame_for(parameters, name)
    return passed if passed is None or passed == name else uses.name_seen_from(call.scope, passed)


def routine_calls(text: str, routines: Mapping[str, tuple[int, int]]) -> Iterator[RoutineCall]:
    """Yield the calls of routines that pass something."""
    routine_names = {scope.partition("/")[2] for scope in routines}
    for scope, (begin, end) in routines.items():
        header = _HEADER.match(text, begin, end)
        place, leads, in_condition = header.end() if header else begin, True, False
        while (found := _CODE.search(text, place, end)) is not None:
            place = found.end()
            if found[0][0] in '!"':
                continue
            if found[0][-1] == ";":
                leads, in_condition = True, False
                continue
            word = _late_name(found) if found[0][0] == "%" else decode_name(found[0]).lower()
            opened = OPENED.match(text, place)
            called = opened is not None and opened[1] is not None
            if (
                word in routine_names
                or (called and (word in _COMPUTING_JOINTS or not is_of_robotware(word)))
                or (leads and word not in _NO_CALLS and _PASSES.match(text, place))
                or (in_condition and _is_called_behind(word, text, place))
            ):
                yield _read_call(text, (opened.end() if opened and called else place, end), (scope, word))
            leads = word in _LEADING
            in_condition = word == "if" or (in_condition and not leads)


def _is_called_behind(word: str, text: str, place: int) -> bool:
    """Return whether a word of ``IF condition routine arguments;`` may be the routine: no operator is behind it."""
    behind = _NEXT_NAME.match(text, place)
    operates = behind is not None and is_of_robotware(behind[1].lower())
    return not operates and not is_of_robotware(word) and _PASSES.match(text, place) is not None


def _late_name(found: re.Match[str]) -> str:
    """Return the routine that a call by a value means; one that is computed, or moves itself, has no name."""
    alone = found["late"] is not None and found[0].strip("% \t") == f'"{found["late"]}"'
    name = found["late"].rpartition(":")[2].lower() if alone else ""
    return _ANY_ROUTINE if not name or name in MOVES else name


def _read_call(text: str, span: tuple[int, int], call: tuple[str, str]) -> RoutineCall:
    arguments: list[str] = []
    parts: list[str] = []
    options: dict[str, str] = {}
    references: list[str] = []
    stated: ParameterUse | None = None
    for is_option, part in split_arguments(text, span):
        named = OPTION.match(part) if is_option else None
        reference = _REFERENCE.fullmatch(part, 0 if named is None else named.end())
        references += [decode_name(reference[1])] if reference is not None else []
        if named is not None:
            option = decode_name(named[1]).lower()
            options[option] = _passed_name(part[named.end() :], span[0])
            if option == _WORK_OBJECT:
                stated = ParameterUse(
                    arguments[-1] or None if len(arguments) > 1 else None, options[option] or None
                )
        elif not is_option:
            arguments.append(_passed_name(part, span[0]))
            component = _COMPONENT.fullmatch(part)
            parts.append(decode_name(component[1]) if component else "")
    if call[1] in _COMPUTING_JOINTS and stated is None and len(arguments) > 1:
        stated = ParameterUse(arguments[1] or None, "wobj0")
    return RoutineCall(*call, tuple(arguments), options, tuple(parts), stated, references=tuple(references))


def _passed_name(part: str, at: int) -> str:
    """Return the name of the data that an argument is, or Offs of it, or a component of a record; "" for else.

    A place that is measured has the name under which it is followed, with ``at``.
    """
    if measured := measured_name(part, 0, at):
        return measured
    place = _PLACE.fullmatch(part) or _RECORD.fullmatch(part)
    if place is None:
        return ""
    index = "".join((place[2] or "").split())
    return decode_name(place[1]) + (f"{{{index}}}" if INDEX.fullmatch(index) else "")


def split_arguments(text: str, span: tuple[int, int]) -> Iterator[tuple[bool, str]]:
    """Yield the arguments of a call, and whether each is an option, up to its closing sign."""
    start, is_option, depth = span[0], False, 0
    for count, found in enumerate(_ARGUMENT.finditer(text, *span)):
        if not depth and found[0] in (",", ";", ")", "\\"):
            part = _COMMENT.sub(" ", text[start : found.start()])
            if not is_option:
                part = NAMED_ARGUMENT.sub("", part, count=1)
            if part.strip():
                yield is_option, part
            if found[0] in ";)" or count > _MOST_TOKENS:
                return
            start, is_option = found.end(), found[0] == "\\"
        depth += (found[0] in "[({") - (found[0] in "])}")
