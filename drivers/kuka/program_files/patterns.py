"""Statements of KRL as patterns, words that begin or end things, and what is remarked of them."""

import re

B = r"[ \t\r]"
MOTION = re.compile(
    rf"{B}*+(PTP|LIN|CIRC|SPTP|SLIN|SCIRC|SPL)(_REL)?+(?![\w$.=\[(]){B}*+(?!=)", re.ASCII | re.IGNORECASE
)
WITH = re.compile(r"\bWITH\b", re.IGNORECASE)
ROUTINE = re.compile(rf"{B}*+(?:GLOBAL{B}++)?+(?:DEF|DEFFCT{B}++\w++)\b{B}*+(\w*+)", re.ASCII | re.IGNORECASE)
CALLS = re.compile(rf"(?<![\w.$])([A-Za-z_]\w*+){B}*+\(", re.ASCII)  # in conditions and values, too
CALLED_IN_WITH = re.compile(  # other than the functions of the inline forms, which read frame and motion data
    rf"(?<![\w.$])(?!S(?:VEL|ACC|TOOL|BASE|IPO|LOAD|APO|ORI|GEAR|JERK)\w*+{B}*+\()[A-Za-z_]\w*+{B}*+\(",
    re.ASCII | re.IGNORECASE,
)
READING_CALL = re.compile(
    rf"\bS(?:VEL|ACC|TOOL|BASE|IPO|LOAD|APO|ORI|GEAR|JERK)\w*+(?={B}*+\()", re.IGNORECASE
)
INTERRUPT = re.compile(  # what it declares, whether also for callers, and the routine that runs then
    rf"{B}*+(GLOBAL{B}++)?+INTERRUPT{B}++DECL\b[^\n]*\bDO{B}++([A-Za-z_]\w*+)", re.ASCII | re.IGNORECASE
)
TRIGGER = re.compile(rf"{B}*+TRIGGER\b", re.IGNORECASE)  # what it calls runs during the motions below
FRAME_DATA_SET = re.compile(rf"{B}*+FDAT_ACT{B}*+={B}*+(\w++)", re.ASCII | re.IGNORECASE)
FRAME_PASSED = re.compile(
    rf"{B}*+\$(TOOL|BASE|ROBROOT|WORLD|ERSYSROOT){B}*+(?:\.{B}*+\w++{B}*+)?+", re.IGNORECASE
)
FRAME_DATA_COMPONENT = re.compile(  # of frame data: the tool, the base, or which of them stands in the cell
    rf"{B}*+([A-Za-z_]\w*+){B}*+(?:\[[^\[\]\n]*+\]{B}*+)?+\.{B}*+(?:TOOL_NO|BASE_NO|IPO_FRAME){B}*+=(?!=)",
    re.ASCII | re.IGNORECASE,
)
PREPARED = re.compile(  # what stands around every taught move
    rf"{B}*+(?:FDAT_ACT{B}*+={B}*+(\w++)|(?:LDAT_ACT|PDAT_ACT|\$BWDSTART){B}*+={B}*+\w++){B}*+",
    re.ASCII | re.IGNORECASE,
)
NAMES_POINT = re.compile(rf"{B}*+([A-Za-z_]\w*+){B}*+(?:\[([^\[\]]*+)\])?+", re.ASCII)
WORD = re.compile(r"(?<![\w.$#])([A-Za-z_]\w*+)(?:\[([^\[\]]*+)\])?+", re.ASCII)
DATA = re.compile(  # a name with its index, and a component of it
    rf"{B}*+([$A-Za-z_][\w$]*+){B}*+(?:\[([^\[\]]*+)\]{B}*+)?+((?:\.{B}*+\w++{B}*+)*+)", re.ASCII
)
OF_PLACE = re.compile(rf"(?:\.{B}*+(?:[XYZABC]|A[1-6]|E[1-6]){B}*+)?", re.IGNORECASE)
BAS = re.compile(
    rf"\bBAS{B}*+\({B}*+#(TOOL|BASE|EX_BASE|PTP_PARAMS|CP_PARAMS|FRAMES|INITMOV){B}*+,?+{B}*+([^)]*+)",
    re.IGNORECASE,
)
BAS_CHOSEN = re.compile(rf"\bBAS{B}*+\({B}*+[^#\s]", re.IGNORECASE)  # a variable says what it does
FRAME_SET = re.compile(
    rf"(?<![\w.])\$(TOOL|BASE|IPO_MODE|ACT_EX_AX)\b({B}*+\.{B}*+[XYZABC])?+{B}*+=(?!=){B}*+", re.IGNORECASE
)
HELD_TOOL = re.compile(r"#BASE\b", re.IGNORECASE)  # any other value of $IPO_MODE may be #TCP
RECORD_SET = re.compile(rf"(?:{B}*+\.{B}*+\w++{B}*+(?:\[[^\[\]\n]*+\]{B}*+)?+)++=(?!=){B}*+", re.ASCII)
BEHIND_DO = re.compile(rf"\bDO{B}++(?=[^\n=]*?=(?!=))", re.IGNORECASE)  # an assignment, done at another time
FROM_KINEMATICS = re.compile(  # a base that an external axis turns: root, kinematics, base on it
    rf"EK{B}*+\([^(){{}}\n]{{0,120}}?\bBASE_DATA{B}*+\[{B}*+(\d++){B}*+\]{B}*+\){B}*+", re.IGNORECASE
)
FROM_TABLE = re.compile(rf"(?:TOOL|BASE)_DATA{B}*+\[{B}*+(\d++){B}*+\]{B}*+", re.IGNORECASE)
BEGIN_ROUTINE = frozenset(("GLOBAL", "DEF", "DEFFCT"))
MOVE = frozenset(
    name + more for name in ("PTP", "LIN", "CIRC", "SPTP", "SLIN", "SCIRC", "SPL") for more in ("", "_REL")
)
BRANCHES = frozenset(
    ("IF", "SWITCH", "WHILE", "FOR", "ELSE", "CASE", "DEFAULT", "ENDIF", "ENDSWITCH", "ENDWHILE", "ENDFOR")
)
BESIDE = frozenset(("INTERRUPT", "GLOBAL", "TRIGGER"))  # what they do is done at another time
FRAME_DATA_ACTIVE = "FDAT_ACT"
MOTION_DATA = frozenset(
    (FRAME_DATA_ACTIVE, "LDAT_ACT", "PDAT_ACT")
)  # of the controller's types: never positions
ROOTS = frozenset(("$ROBROOT", "$WORLD", "$ERSYSROOT"))  # where the robot stands, and what its bases stand in
TABLES = {"TOOL_DATA": "TOOL", "BASE_DATA": "BASE"}
TABLE_SET_BESIDE = re.compile(rf"\bDO{B}++((?:TOOL|BASE)_DATA)\b", re.IGNORECASE)
NAME_VALUE = re.compile(r"(?!(?:TRUE|FALSE)\b)[A-Za-z_$(]", re.IGNORECASE)  # no number, truth or choice
NULL = re.compile(rf"\$?NULLFRAME{B}*+", re.IGNORECASE)
WORLD = re.compile(rf"\$WORLD{B}*+", re.IGNORECASE)  # a base there is the null frame
STRUCT = re.compile(r"\{[^{}]*+\}")
OF_POINT = re.compile(r"\bE?6?POS\b|\b[ST][ \t]+[\d']", re.IGNORECASE)
TOOL_AXES = re.compile(r"#TOOL\b", re.IGNORECASE)
COMPONENT = re.compile(
    rf"{B}*+[$A-Za-z_][\w$]*+(?:{B}*+\[[^\[\]\n]*+\])?+{B}*+\.{B}*+(?:[XYZABC]|A[1-6]|E[1-6]){B}*+=(?!=)",
    re.ASCII | re.IGNORECASE,
)
CALLED = re.compile(rf"[$A-Za-z_][\w$]*+{B}*+\(", re.ASCII)
POINT_VALUE = re.compile(r":|\$POS_|\$AXIS_|\bINVERSE\b|\bFORWARD\b", re.IGNORECASE)
CIRCULAR_ANGLE = re.compile(
    r",[ \t]*+CA(?:[ \t]|=|[-+.\d])", re.IGNORECASE
)  # behind the two points of a circle
MOST_TARGETS = 3  # a circle has two
MOST_DIGITS = 9
DEEPEST = 30  # branches inside each other
CALLS_NOTHING = frozenset(("EXT", "EXTFCT", "SPLINE", "PTP_SPLINE"))  # declared, or functions of the language
_SYSTEM_CALLS = (  # of the inline forms and of INI: they set no tool and no base, and move nothing
    "SET_CD_PARAMS", "IR_STOPM", "ARCMAINNG", "ARCGETDELAY", "ARCGETPATH",
)  # fmt: skip
_BASES = ("EK", "EB", "EB_ABS", "LK")  # they return a base, and give nothing a value
KNOWN_CALLS = frozenset(
    ("BAS", "IF", "WHILE", "UNTIL", "SWITCH", "NOT", "AND", "OR", "FOR", *_BASES, *_SYSTEM_CALLS)
)
TAKING_FRAME_DATA = frozenset(
    ("STOOL", "STOOL2", "SBASE", "SIPO_MODE", "SLOAD")
)  # functions of the inline forms that read them
CORRECTIONS = frozenset(
    ("BASE_CORR_ON", "M_BAS_COR_ON")
)  # BAS.SRC then shifts every base, in its own axes or the world's
LOOPS = frozenset(("LOOP", "REPEAT"))
JUMP_TARGETS = frozenset(("ENDLOOP", "UNTIL"))
# RobotSensorInterface: what it is sent corrects the motions that follow, or moves the robot by itself.
GUIDES = frozenset(("RSI_ON", "RSI_MOVECORR", "ST_ON", "ST_ON1", "ST_MOVESENS"))
ASYNCHRONOUS = frozenset(("ASYPTP", "ASYCONT"))
SENSOR = "TS_BC"  # TouchSense: corrections from what was found
SET_BY_POINTS = frozenset(("PTP_PARAMS", "CP_PARAMS", "FRAMES"))
OFFSET = "The operator ':' adds a frame to this point while the program runs."
RELATIVE_AXES = "it goes on from where the robot is, axis by axis"
RELATIVE = "A relative move: it goes on from where the robot is, and stays as it is."
CALL = "The target of this move is computed."
ASSIGNED = "{} is set while the program runs; that value is not read."
FRAME_SET_TEXT = "${} is set while the program runs; points written into moves are in it."
FOUND = "{} corrects the points that follow by what a sensor finds."
EXTERNAL_TEXT = (
    "$IPO_MODE is set here: with #TCP, the tool stands in the cell, and the points are not changed."
)
COUPLED_TEXT = (
    "$ACT_EX_AX couples the base to an external axis here: state that axis in the project as [[positioner]], with "
    "this base under frames."
)
POINT_STRUCT = re.compile(r"\{[^{}]*?(?:\b[XYZABC]|\bA[1-6])[ \t]+[-+.\d]", re.IGNORECASE)


def end_of_target(code: str, place: int) -> int:
    """Return where the comma behind a target stands, or the code's end; commas in brackets are the target's own."""
    deep = 0
    for at in range(place, len(code)):
        if code[at] in "({[":
            deep += 1
        elif code[at] in ")}]":
            deep -= 1
        elif code[at] == "," and deep <= 0:
            return at
    return len(code)
