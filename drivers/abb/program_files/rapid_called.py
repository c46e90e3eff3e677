"""Procedures that a RAPID module calls, by name or by a name that is computed (``%"Pick"+part%;``)."""

import re

from cellcal.drivers.abb.program_files.displacements import WORDS
from cellcal.drivers.abb.program_files.instructions import MOVES
from cellcal.drivers.programs.called_routines import CalledRoutine, RoutineNames, function_moves
from cellcal.drivers.programs.line_numbers import LineNumbers

_HIDDEN = re.compile(r'![^\n]*|"(?:[^"\n]|"")*"')
_TEXT = '"' + r'(?:[^"\n]|"")*+' + '"'
_LATE = re.compile(  # or a text, in which % means nothing
    rf'{_TEXT}|%[ \t]*+({_TEXT})?((?:[^%;\n"]|{_TEXT})*+)%(?=[^%;\n]*+;)'
)
_BY_VARIABLE = re.compile(rf"\bCallByVar[ \t]++({_TEXT})?([^;\n]*+);", re.IGNORECASE)
# What stands before a statement without a semicolon of its own.
_BEFORE = re.compile(
    r"\b(?:THEN\b|ELSE\b|DO\b|DEFAULT[ \t]*:|ERROR\b|UNDO\b|BACKWARD\b)"
    r"|\bEND(?:IF|FOR|WHILE|TEST|PROC|FUNC|TRAP|MODULE|RECORD)\b"
    r"|\bCASE\b[^:;]{0,400}:|^[ \t]*[A-Za-z]\w*[ \t]*:(?!=)"
    r"|\b(?:PROC|TRAP|FUNC[ \t]+\w+)\b[^\n(]{0,200}(?:\([^)]{0,2000}\))?"
    r"|\bRECORD\b(?:[^;!]{0,200};){0,100}?\s{0,200}ENDRECORD\b"
    r"|\bMODULE[ \t]+\w+(?:[ \t]*\([^)]{0,200}\))?",
    re.IGNORECASE | re.MULTILINE,
)
_CALL = re.compile(r"([A-Za-z]\w*)\s*(?=\Z|\\|\s[\s]*[A-Za-z0-9\[\-+\"\\?(])(?!\s*(?:\{|\.|:=))")
_IN_EXPRESSION = re.compile(r"(?<![\w.\\])([A-Za-z]\w*)[ \t]*\(", re.ASCII)
_COMPACT = re.compile(r"IF\b.*?[\w)\]]\s+([A-Za-z]\w*)\s*\Z", re.IGNORECASE | re.DOTALL)
_DECLARES = re.compile(r"(?:LOCAL\s+)?(?:PROC|FUNC|TRAP)\b", re.IGNORECASE)
_OPERATORS = frozenset(["and", "or", "not", "xor", "div", "mod"])
_ENDS_WITH_OPERATOR = re.compile(
    r"(?:\b(?:AND|OR|NOT|XOR|DIV|MOD|GOTO|RETURN)|[=<>+\-*/(,])\s*\Z", re.IGNORECASE
)
_LANGUAGE_TEXT = (
    "elseif if for while test goto return raise retry trynext exit exitcycle stop break var pers const local task "
    "record func proc trap module connect alias waittime waituntil waitdi waitdo waitai waitao waitgi waitgo waitrob "
    "waitload waitsyncmovetask waitsensor waitwobj waittestandset setdo setgo setao set reset pulsedo invertdo "
    "tpwrite tperase tpreadfk tpreadnum tpreaddnum tpshow uimsgbox uimsgwrite uimsgwriteabort uishow write "
    "writebin writestrbin writeanybin writerawbytes writevar writeblock open close rewind makedir removedir "
    "removefile renamefile copyfile clearrawbytes packrawbytes unpackrawbytes packdnheader copyrawbytes "
    "readrawbytes readanybin readerrdata readblock readcfgdata writecfgdata readvararr clearpath clearibuff "
    "socketcreate socketconnect socketclose socketsend socketreceive socketbind socketlisten socketaccept "
    "socketsendto socketreceivefrom accset pathacclim velset speedrefresh speedlimaxis speedlimcheckpoint "
    "spdoverride singarea confl confj mocload gripload loadid mechunitload paridrobvalid paridposvalid load "
    "unload startload cancelload erase save checkprogref isignaldi isignaldo isignalai isignalao isignalgi "
    "isignalgo idelete idisable ienable isleep iwatch itimer ierror ipers ivarvalue ipathpos irmqmessage "
    "getdatavalue setdatavalue setdatasearch setalldatavalue clkstart clkstop clkreset incr decr add clear bitset "
    "bitclear errwrite errlog errraise booknoerr bookerrno actunit deactunit pathresol worldacclim corrcon "
    "corrdiscon corrclear corrwrite softact softdeact softelect tuneservo tunereset motionsup dyncalc stopmove "
    "startmove stopmovereset startmoveretry storepath restopath pathrecstart pathrecstop restorepath syncmoveon "
    "syncmoveoff syncmoveundo syncmovesuspend syncmoveresume waitsynctask triggio triggequip triggint "
    "triggcheckio triggrampao triggspeed triggstopproc triggdatareset triggdatacopy synctosensor syncsensor "
    "dropsensor dropwobj recordwobj actevent deactevent callbyvar indreset indamove indcmove inddmove indrmove "
    "processrunning procerrrecovery procerrrecover systemstopaction resetretrycount resetppmoved setsysdata "
    "getsysdata getjointdata getmaxnumberofdata gettrapdata gettorque gettorquemargin hollowwristreset iodisable "
    "ioenable iobusstart iobusstate iounitstate idcm texttabinstall testsigndefine testsignreset cirpathmode "
    "camflush camgetexposure camgetloadedjob camgetname camgetparameter camgetresult camloadjob camreqimage "
    "camsetexposure camsetparameter camsetprogrammode camsetrunmode camstartloadjob camwaitloadjob "
    "camgetstringvalue cnvgenevent counter rmqemptyqueue rmqfindslot rmqgetmessage rmqgetmsgdata rmqgetmsgheader "
    "rmqreadwait rmqsendmessage rmqsendwait sensoron sensoroff siaopen siaclose sigetcyclic sisetcyclic siconnect "
    "siclose wzboxdef wzcyldef wzdisable wzdoset wzenable wzfree wzhomejointdef wzlimjointdef wzlimsup wzsphdef "
    "egmreset egmgetid egmsetupuc egmsetupai egmsetupao egmstop egmstreamstart egmstreamstop egmactpose "
    "egmactjoint fcact fcdeact fccalib fccondforce fccondpos fccondwaitwhile fcrefforce fcrefstart fcrefstop "
    "fcsupforce arcrefresh arckill setleads spcheckrun accsetmax pdispoff eoffsoff uimessagebox reserve release "
    "limconfsupp contactdef safetycontrollerstate wait setupsuppress acteventbuffer aliascamera capaptrsetup "
    "caplatrsetup capnoprocess caprefresh capweavesync deacteventbuffer ditheract ditherdeact egmactmove egmrunjoint "
    "egmrunpose egmsetupgi egmsetupltapp erasemodule fitcircle fricidevaluate fricidsetfriclevels getdataval "
    "getgroupsignalinfo manloadidproc matrixsolve matrixsolveqr matrixsvd motionprocessmodeset moveextj "
    "mtoolrotcalib mtooltcpcalib pathlengthreset pathlengthstart pathlengthstop pathrecmovebwd pathrecmovefwd "
    "prxactivandstorerecord prxactivrecord prxresetpos prxstartrecord prxusefilerecord raisetouser "
    "removeallcyclicbool removecyclicbool resetaxismovetime searchextj sendevice setalldataval setdataval "
    "setleadthrough setupcyclicbool setupsuperv spystart spystop stcalib stepbwdpath stindgun stoolrotcalib "
    "stooltcpcalib sttune tryint warmstart workobjact setmechunit socketgetstatus socketpeek "
)
OF_LANGUAGE = frozenset(_LANGUAGE_TEXT.split())


def called_procedures(data: bytes) -> tuple[CalledRoutine, ...]:
    """Return the calls of procedures that are none of the language, in the order of the lines."""
    source = data.decode("latin-1")
    lines = LineNumbers(source)
    late = [
        CalledRoutine(lines.line_of(each.end()), f"%{each[1] or ''}{each[2]}%", _late_pattern(each))
        for each in _LATE.finditer(_without_comments(source))
        if each[0].startswith("%")
    ]
    late += [
        CalledRoutine(lines.line_of(each.start()), each[0].rstrip(";"), _late_pattern(each))
        for each in _BY_VARIABLE.finditer(_without_comments(source))
    ]
    text = _HIDDEN.sub(_blank, source)
    text = _BEFORE.sub(lambda each: ";" + each[0][1:].translate(_BLANKS), text)
    found, line = late, 1
    for piece in text.split(";"):
        body = piece.strip()
        start = line + piece[: len(piece) - len(piece.lstrip())].count("\n")
        line += piece.count("\n")
        name = _called_in(body)
        found += [
            CalledRoutine(start + body.count("\n", 0, each.start()), each[1])
            for each in _IN_EXPRESSION.finditer(body)
            if function_moves(each[1]) and each[1].lower() not in MOVES and not _DECLARES.match(body)
        ]
        if name:
            found.append(CalledRoutine(start + (body.count("\n")), name))
    return tuple(sorted(found))


class _AllBlank(dict[int, str]):
    def __missing__(self, sign: int) -> str:
        return "\n" if sign == ord("\n") else " "


_BLANKS = _AllBlank()


def _blank(found: re.Match[str]) -> str:
    return '"' + " " * (len(found[0]) - 2) + '"' if found[0][0] == '"' else " " * len(found[0])


def _without_comments(text: str) -> str:
    return _HIDDEN.sub(lambda each: each[0] if each[0][0] == '"' else " " * len(each[0]), text)


def _called_in(body: str) -> str:
    """Return the procedure that a statement calls, "" where it calls none."""
    if body[:2].upper() == "IF":
        compact = _COMPACT.match(body)
        if compact is None or _ENDS_WITH_OPERATOR.search(body[: compact.start(1)]):
            return ""
        name = compact[1]
    else:
        called = _CALL.match(body)
        if called is None or ":=" in body.split("\\", 1)[0]:
            return ""
        name = called[1]
    lower = name.lower()
    return "" if lower in MOVES or lower in WORDS or lower in OF_LANGUAGE else name


def _late_pattern(found: re.Match[str]) -> str:
    """Return which names a computed one may be: with what it begins, where that is written, and anything behind."""
    begins = (found[1] or '""')[1:-1].upper().rpartition(":")[2]  # a module's name may stand before it
    return begins + ("*" if found[2].strip() or not begins else "")


_ROUTINE = re.compile(r"^[ \t]*(?:LOCAL[ \t]+)?(?:PROC|TRAP|FUNC[ \t]+\w+)[ \t]+([A-Za-z]\w*)", re.I | re.M)


def own_procedures(data: bytes) -> frozenset[str]:
    """Return the routines of a module."""
    return frozenset(name.upper() for name in _ROUTINE.findall(data.decode("latin-1")))


NAMES = RoutineNames(called_procedures, own_procedures)
