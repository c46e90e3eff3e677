"""Lines as the controller itself writes them: nearly all of a large program, each read with one match.

They say what the readers in `data_list` and `program` make of them; what is written otherwise in any way goes there.
"""

import re

from cellcal.drivers.kuka.program_files.lines import LINE
from cellcal.drivers.kuka.program_files.literals import POSE_FIELDS

BEFORE_NUMBER = 3  # characters of a point between its numbers: a brace or a comma, the letter, a blank
_NUMBER = r"-?\d{1,5}+(?:\.\d{1,12}+)?+"  # none is too large or too long
_NAME = r"[A-Za-z_]\w*+"
_END = r"[ \t]*+\r?+\n"

_POINT = (  # its name begins as no tool's and no base's does
    r"DECL (?P<kind>E6POS|POS) (?P<name>X\w*+)=(?P<brace>\{)"
    + ",".join(rf"{name} (?P<{name}>{_NUMBER})" for name in POSE_FIELDS)
    + rf"(?P<state>(?:,S \d{{1,3}}+,T \d{{1,3}}+)?+)(?P<external>(?:,E[1-6] {_NUMBER})*+)\}}{_END}"
)
DATA_LINE = re.compile(
    rf"(?P<a_point>{_POINT})"
    rf"|(?P<a_frame_data>DECL FDAT (?P<data_name>{_NAME})=(?P<data>\{{[^\n;]*+)\n)"
    rf"|(?P<a_motion_data>DECL [LP]DAT {_NAME}=(?P<motion_data>\{{[^\n;]*+)\n)"
    rf"|{LINE}",
    re.ASCII,
)

DECLARATION = re.compile(  # names alone
    rf'DECL (?:E6POS|POS) (?P<point>{_NAME})=\{{[^}};"\n]*+\}}{_END}'
    rf"|DECL FDAT (?P<data>{_NAME})=[^\n]*+\n"
    r"|DECL [LP]DAT [^\n]*+\n"
    rf"|{LINE}",
    re.ASCII,
)

_COMMENT = r"[ \t]*+;[^\n{]*+(?:\{\w*+\}[^\n{]*+)?+\n"  # what is in braces is a word, so it holds no position
TAUGHT_MOVE = re.compile(  # with the point's own frame data
    rf"(?P<a_taught_move>(?:{_COMMENT}){{0,4}}+"
    rf"(?:[ \t]*+\$BWDSTART=\w++{_END})?+"
    rf"(?:[ \t]*+[LP]DAT_ACT=\w++{_END})?+"
    rf"[ \t]*+FDAT_ACT=F(?P<point>\w++){_END}"
    rf"[ \t]*+(?P<bas>BAS)\(#(?:CP|PTP)_PARAMS,[\d.]++\){_END}"
    rf"[ \t]*+(?:LIN|PTP) X(?P=point)(?: C_(?:DIS|ORI|VEL|PTP))?+{_END})"
    rf"|{LINE}",
    re.ASCII,
)
