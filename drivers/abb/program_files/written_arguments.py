"""Data that RAPID instructions and routines give a value which they get as an argument."""

import re
from collections.abc import Iterator, Mapping, Sequence, Set
from typing import NamedTuple

from cellcal.drivers.abb.program_files.frame_facts import FRAME_PARTS
from cellcal.drivers.abb.program_files.literals import INDEX, NAME, NOT_CODE, OPENED, OPTION, W, decode_name
from cellcal.drivers.abb.program_files.passed_targets import RoutineParameters, split_arguments
from cellcal.drivers.abb.program_files.rapid_called import OF_LANGUAGE
from cellcal.drivers.programs.routine_calls import RoutineParameter

# By instruction or function of the language: which of its arguments that are not optional get a value.
_WRITING: Mapping[str, tuple[int, ...]] = {
    **dict.fromkeys(("add", "incr", "decr", "clear", "bitset", "bitclear", "getsysdata"), (0,)),
    "setdataval": (0,),  # whose argument names the data in quotes
    **dict.fromkeys(("tpreadnum", "tpreaddnum", "tpreadfk"), (0,)),
    **dict.fromkeys(("strtoval", "getdataval", "readanybin", "rmqgetmsgdata"), (1,)),
    **dict.fromkeys(("unpackrawbytes", "readcfgdata", "mtoolrotcalib"), (2,)),
    "stoolrotcalib": (3,),
    **dict.fromkeys(("stooltcpcalib", "mtooltcpcalib"), (4,)),
}
# Instructions that give none of their arguments a value which is a place; any other of the language may.
_READING_TEXT = (
    "elseif if for while test goto return raise retry trynext exit exitcycle stop break var pers const local task "
    "record func proc trap module connect alias waittime waituntil waitdi waitdo waitai waitao waitgi waitgo waitrob "
    "waitload waitsyncmovetask waitsensor waitwobj dropwobj recordwobj setdo setgo setao set reset pulsedo invertdo "
    "tpwrite tperase tpshow uimsgbox uimsgwrite uimsgwriteabort uishow write writebin writestrbin writeanybin "
    "writerawbytes writevar writeblock open close rewind makedir removedir removefile renamefile copyfile "
    "clearrawbytes packrawbytes packdnheader clearpath clearibuff socketcreate socketconnect socketclose socketsend "
    "socketbind socketlisten socketaccept socketsendto accset pathacclim velset speedrefresh speedlimaxis "
    "speedlimcheckpoint spdoverride singarea confl confj mocload gripload loadid mechunitload paridrobvalid "
    "paridposvalid load unload startload cancelload erase save checkprogref isignaldi isignaldo isignalai isignalao "
    "isignalgi isignalgo idelete idisable ienable isleep iwatch itimer ierror ipers ipathpos irmqmessage clkstart "
    "clkstop clkreset errwrite errlog errraise booknoerr actunit deactunit pathresol worldacclim corrcon corrdiscon "
    "corrclear corrwrite softact softdeact softelect tuneservo tunereset motionsup dyncalc stopmove startmove "
    "stopmovereset startmoveretry storepath restopath pathrecstart pathrecstop restorepath syncmoveon syncmoveoff "
    "syncmoveundo syncmovesuspend syncmoveresume waitsynctask triggio triggequip triggint triggcheckio triggrampao "
    "triggspeed triggstopproc triggdatareset triggdatacopy synctosensor syncsensor dropsensor actevent deactevent "
    "indreset resetretrycount setsysdata cirpathmode setalldataval setalldatavalue rmqsendmessage egmreset "
    "egmsetupuc egmsetupai egmsetupao egmsetupgi egmstop egmstreamstart egmstreamstop egmactpose egmactjoint "
    "egmactmove egmrunjoint egmrunpose fcact fcdeact fccalib fccondforce fccondpos fccondwaitwhile fcrefforce "
    "fcrefstart fcrefstop fcsupforce pdispoff eoffsoff setleads arcrefresh arckill limconfsupp contactdef wait "
    "moveextj indamove indcmove inddmove indrmove callbyvar sensoron sensoroff wzboxdef wzcyldef wzsphdef"
)
_MAY_GIVE = OF_LANGUAGE - frozenset(_READING_TEXT.split()) - _WRITING.keys()
_DATA = re.compile(
    rf"{W}({NAME}){W}(?:\{{([^{{}};]*+)\}}{W})?+(?P<part>\.[^;,()]*+)?+(?:\\[^;,]*+)?+", re.ASCII
)
_PLACE = re.compile(rf"\.\s*+(?:trans|rot|robax|{'|'.join(FRAME_PARTS)})\b|\A\Z", re.IGNORECASE)
_BY_NAME = re.compile(rf'{W}"({NAME})"{W}', re.ASCII)
_MOST_ROUNDS = 20


class WrittenArgument(NamedTuple):
    """Data that a call gives a value, or a component of it."""

    place: int  # of the call
    scope: str
    name: str
    part: str  # the component; "" for the whole


class _Passed(NamedTuple):
    """The value that a call passes to one parameter."""

    parameter: tuple[str, str]  # scope, name; of the language's own "", ""
    argument: WrittenArgument


def find_written(
    text: str,
    routines: Mapping[str, tuple[int, int]],
    parameters: RoutineParameters,
    given: Set[tuple[str, str]],
) -> Iterator[WrittenArgument]:
    """Yield data that calls give a value; ``given`` are scopes and names that get one in a statement.

    The parameters that do so are noted, for the files that call these routines.
    """
    parameters.written |= {
        (scope, one.name)
        for scope, its in parameters.of_scope.items()
        for one in its
        if not one.by_value and (scope, one.name) in given
    }
    passed = list(_iterate_passed(text, routines, parameters))
    for _ in range(_MOST_ROUNDS):  # a routine may pass its parameter on
        more = {
            (one.argument.scope, its.name)
            for one in passed
            if one.parameter == ("", "") or one.parameter in parameters.written
            for its in parameters.of_scope.get(one.argument.scope, ())
            if its.name == one.argument.name.lower() and not its.by_value
        }
        if more <= parameters.written:
            break
        parameters.written |= more
    for one in passed:
        is_parameter = any(
            its.name == one.argument.name.lower() for its in parameters.of_scope.get(one.argument.scope, ())
        )
        if (one.parameter == ("", "") or one.parameter in parameters.written) and not is_parameter:
            yield one.argument


def _iterate_passed(
    text: str, routines: Mapping[str, tuple[int, int]], parameters: RoutineParameters
) -> Iterator[_Passed]:
    """Yield what calls pass to parameters that may get a value: of the language's own, and of this file's."""
    of_name: dict[str, list[str]] = {}
    for scope, its in parameters.of_scope.items():
        if any(not one.by_value for one in its):
            of_name.setdefault(scope.partition("/")[2], []).append(scope)
    for word, where, arguments in _iterate_calls(text, routines, (*_WRITING, *_MAY_GIVE, *of_name)):
        for callee in _called_scopes(of_name.get(word, ()), where[1]):
            for name, part in _passed_to(parameters.of_scope[callee], arguments):
                yield from _read_data((callee, name), part, where)
        for part in () if word in of_name else _given_by_language(word, arguments):
            yield from _read_data(("", ""), part, where)


def _iterate_calls(
    text: str, routines: Mapping[str, tuple[int, int]], names: Sequence[str]
) -> Iterator[tuple[str, tuple[int, str], list[tuple[bool, str]]]]:
    """Yield the calls of some names: the name, its place and scope, and the arguments."""
    small = text.lower()
    words = "|".join(re.escape(name) for name in names if name in small)  # a large program has none of them
    if not words:
        return
    code = re.compile(rf"{NOT_CODE}|(?<!\w)(?P<called>{words})(?!\w)", re.IGNORECASE)
    for scope, (begin, end) in routines.items():
        for found in code.finditer(text, begin, end):
            if found["called"] is None:
                continue
            opened = OPENED.match(text, found.end())
            span = (opened.end() if opened and opened[1] else found.end(), end)
            yield found["called"].lower(), (found.start(), scope), list(split_arguments(text, span))


def _given_by_language(word: str, arguments: Sequence[tuple[bool, str]]) -> Iterator[str]:
    """Yield the arguments that an instruction of the language gives a value."""
    plain = [part for is_option, part in arguments if not is_option]
    if word in _MAY_GIVE:
        for is_option, part in arguments:
            named = OPTION.match(part) if is_option else None
            yield part[named.end() :] if named is not None else "" if is_option else part
        return
    for k in _WRITING[word]:
        part = "".join(plain[k : k + 1])
        by_name = _BY_NAME.fullmatch(part) if word == "setdataval" else None
        yield by_name[1] if by_name else part


def _called_scopes(some: Sequence[str], scope: str) -> Sequence[str]:
    """Return the routines that a call means: the one of its own module, else all of the name."""
    module = scope.partition("/")[0]
    own = [one for one in some if one.partition("/")[0] == module]
    return own or some


def _passed_to(
    its: Sequence[RoutineParameter], arguments: Sequence[tuple[bool, str]]
) -> Iterator[tuple[str, str]]:
    """Yield each parameter that is passed by reference, and the text that a call passes for it."""
    plain = [part for is_option, part in arguments if not is_option]
    options = {
        decode_name(named[1]).lower(): part[named.end() :]
        for is_option, part in arguments
        if is_option and (named := OPTION.match(part)) is not None
    }
    required = [one.name for one in its if not one.optional]
    for one in its:
        if one.by_value:
            continue
        text = options.get(one.name, "") if one.optional else "".join(plain[required.index(one.name) :][:1])
        if text:
            yield one.name, text


def _read_data(parameter: tuple[str, str], part: str, where: tuple[int, str]) -> Iterator[_Passed]:
    """Yield the data that an argument is, where its place may change with it."""
    found = _DATA.fullmatch(part)
    if found is None or _PLACE.search(found["part"] or "") is None:
        return
    index = "".join((found[2] or "").split())
    name = decode_name(found[1]) + (f"{{{index}}}" if INDEX.fullmatch(index) else "")
    yield _Passed(parameter, WrittenArgument(*where, name, found["part"] or ""))
