"""Routines of RobotWare that give no tool or work object a value which they get.

Those that do are in `written_arguments`.
"""

from cellcal.drivers.abb.program_files.displacements import WORDS
from cellcal.drivers.abb.program_files.instructions import FORCE_REFERENCES, GUIDES, MOVES, TURNS_AXES
from cellcal.drivers.abb.program_files.rapid_called import OF_LANGUAGE
from cellcal.drivers.programs.routine_calls import RoutineCall

_FUNCTIONS_TEXT = (
    "abs absdnum acos acosdnum aerrread ainput and aoutput argname asin asindnum atan atan2 atan2dnum atandnum "
    "bitand bitanddnum bitcheck bitcheckdnum bitlsh bitlshdnum bitneg bitnegdnum bitor bitordnum bitrsh "
    "bitrshdnum bitxor bitxordnum btres bytetostr calcjointt calcrobt calcrotaxframez calcrotaxisframe "
    "camgetexposure camgetloadedjob camgetmode camgetname camnumberofresults cdate cjointt clkread corrread cos "
    "cosdnum cpos crobt crossprod cspeedoverride csysmode ctime ctool cwobj decttohex defaccframe defdframe "
    "defframe deg dim distance div dnumtonum dnumtostr dotprod doutput egmgetstate eulerzyx eventtype exechandler "
    "execlevel exp fcgetforce fcgetprocessdata fcisforcemode fcload filesize filetime fsgetinfo fssize "
    "getaxisdistance getaxismovetime getmaxnumberofcyclicbool getmecunitname getmodalpayloadmode getmotorbrake "
    "getmotorspeed getnextcyclicbool getnextmechunit getnextsym getnumberofcyclicbool getserviceinfo "
    "getsignalorigin getsysinfo gettaskname gettime getuasuserlevel ginput ginputdnum gooutput goutput "
    "goutputdnum hextodec indinpos indspeed iounitstate isbrakecheckactive iscyclicbool isfile ismechunitactive "
    "ispers isstopmoveact isstopstateevent issyncmoveon issysid isvar max maxexternalspeed maxrobspeed min mirpos "
    "mod modexist modtime motionplannerno nonmotionmode nor norient not notnum numtodnum numtostr offs oprmode or "
    "orientzyx orobt paridposvalid paridrobvalid pathlengthget pathlevel pathrecvalidbwd pathrecvalidfwd "
    "pfrestart poseinv posemult posevect pow powdnum ppmovedinmanmode present progmemfree prxgetmaxrecpos quad "
    "quaddnum rad rawbyteslen readbin readdir readmotor readnum readstr readstrbin readvar reltool "
    "remainingretries rmqgetslotname robname robos round rounddnum runmode safetycontrollergetchecksum "
    "safetycontrollergetopmodepinstate sin sindnum socketgetstatus socketpeek sqrt sqrtdnum stcalcforce "
    "stcalctorque stiscalib stisclosed stisindgun stisopen strdigcalc strdigcmp strfind strformat strlen strmap "
    "strmatch strmemb strorder strpart strtobyte symbolsearch tan tandnum taskruncmec taskrunmec taskrunrob "
    "tasksinsync testanddec testandset testdi testsignread textget textgetindex textgetstr texttabfreetoget "
    "texttabget transpose triggdatavalid trunc truncdnum type uialphaentry uiclientexist uidnumentry uidnumtune "
    "uilistview uimessagebox uinumentry uinumtune validio valtostr vectmagn xor "
)
_WORDS_TEXT = "case elseif return waituntil connect with from to step raise then else do default"
_READING = (
    frozenset(
        (
            *_FUNCTIONS_TEXT.split(),
            *_WORDS_TEXT.split(),
            *OF_LANGUAGE,
            *WORDS,
            *MOVES,
            *GUIDES,
            *FORCE_REFERENCES,
        )
    )
    | TURNS_AXES
)


def is_of_robotware(routine: str) -> bool:
    """Return whether a name, in small letters, is a routine of RobotWare, or a word of the language."""
    return routine in _READING


def only_reads(call: RoutineCall) -> bool:
    """Return whether a call surely gives no tool or work object a value that it passes.

    Routines of processes are many: what gets a place, and its work object by the name that MoveL has for it, is a
    motion.
    """
    return is_of_robotware(call.routine) or (call.stated is not None and any(call.arguments))
