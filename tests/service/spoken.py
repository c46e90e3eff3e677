"""The sentences that errors, rules and reasons are made of, found in the source: literals, holes numbered.

``f"{name}: the wire is {length_m:.3f} m long."`` is ``"{1}: the wire is {2} m long."``, wherever it is said.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TypeGuard

ROOT = Path(__file__).parents[2]
SENTENCE = re.compile(r"(?<=[.?!])\s+")  # as in web/src/lib/say.svelte.ts
# Names of arguments, constants, fields and functions whose texts are read by people.
_BY_NAME = """
    remedy reason why advice rule message problem lacks what words detected_by sentence trouble told saving
    shortfall forecast limits_from not_verified not_checked remarks to_sign suspects_told re_verify
    no_exchange none_to_spare flaw state_flaw chain_flaw chain_flaws what_is_wrong add _cure
    turn_more seen scale unseen forms
    assumed tips after
    several computed later copied different otherwise called caller unused unused_alone barred
    barred_different barred_computed barred_set barred_moved seen_from_flange
    unreachable other_configuration other_turns no_posture fixed cure hindrances occupied
    text question asked
    increment led_motion standing_tool camera any_increment amount other_frame other_group beside_external external
    other_joints shared on_conveyor other_motion any_amount set_here in_tool in_master variable_amount written_remote
    made_by missing_group
    costs costs_each_time size_unreadable inside star_unknown frame_alone relative_axes component_set external_offset
    external_tool element_set not_read conflicts in_script stray
"""
# What is called with a text that is read by people, beside every error.
_CALLED = """
    __init__ Condition Judged SetAside Check Checked Figure Alarm Flaw Prediction Change Characteristic
    Excess at_least at_most judged known_within held stated enough name_flaw _unreadable forget _said
    error wrong damaged refusal _refusal _refused fix
"""
_REMARKS = "Remark remark _remark _grouped _lines _of_functions"  # (where, code, text) of a program's line
SAID_BY_NAME, SAYING = frozenset(_BY_NAME.split()), frozenset(_CALLED.split())
ASKED = frozenset(("Instruction", "Question", "MeterReading"))  # a key or a code, and what is said
REMARKING = frozenset(_REMARKS.split())
_PROSE = re.compile(
    r"(?:[^\s\\|]+\s){2,}[^\\|]*[.]"
)  # three words and a full stop, in a table: no expression
_HOLE = re.compile(r"\{\d+\}")
_OPEN = re.compile(r"\{(?:[a-z]\w*)?(?::[^{}]*)?\}")  # what `format` fills in later
_CODE = re.compile(r"[a-z_]+(\.[a-z_{}0]+)+")  # of an error or alarm: told to programs


def sentences(path: Path) -> set[str]:
    """Return what a file's errors, remedies, rules and reasons say, sentence by sentence."""
    return {
        numbered(part)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for said in _said(node)
        for template in templates(said)
        for part in SENTENCE.split(template)
        if _HOLE.sub("", part).strip(" .,:;'") and not _CODE.fullmatch(part)
    }


def numbered(part: str) -> str:
    """Return a sentence with its holes counted from one, and no space around it."""
    count = iter(range(1, 100))
    return _HOLE.sub(lambda _: f"{{{next(count)}}}", part.strip())


def templates(node: ast.expr) -> Iterator[str]:
    """Return what an expression may say; nothing where that is not written here."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield _OPEN.sub("{0}", node.value)
    elif isinstance(node, ast.JoinedStr):
        parts = (str(part.value) if isinstance(part, ast.Constant) else "{0}" for part in node.values)
        yield _OPEN.sub("{0}", "".join(parts))
    elif isinstance(node, ast.IfExp):
        yield from templates(node.body)
        yield from templates(node.orelse)
    elif isinstance(node, ast.Tuple | ast.List):
        for each in node.elts:
            yield from templates(each)
    elif isinstance(node, ast.Dict):
        for each in node.values:
            yield from templates(each)
    elif isinstance(node, ast.Starred | ast.DictComp | ast.Subscript):
        yield from templates(node.value)
    elif isinstance(node, ast.GeneratorExp | ast.ListComp):
        yield from templates(node.elt)


def _said(node: ast.AST) -> Iterator[ast.expr]:
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name.endswith("Error") or (name in SAYING and not _is_logged(node.func)):
            yield from node.args
        elif name in REMARKING:
            yield from node.args[2:]
        elif name in ASKED:
            yield from node.args[1:2]
        yield from (each.value for each in node.keywords if each.arg in SAID_BY_NAME)
    elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
        names = node.targets if isinstance(node, ast.Assign) else [node.target]
        told = [_name(name) for name in names]
        if any(_says(name) for name in told):
            yield node.value
        elif told[0].isupper():
            yield from (each for each in ast.walk(node.value) if _is_prose(each))
    elif isinstance(node, ast.Dict):
        yield from (
            value
            for key, value in zip(node.keys, node.values, strict=True)
            if isinstance(key, ast.Constant) and key.value in SAID_BY_NAME
        )
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and _says(node.name):
        yield from (each.value for each in ast.walk(node) if isinstance(each, ast.Return) and each.value)


def _name(target: ast.expr) -> str:
    """Return the name that is assigned to, of a table's element the table's."""
    while isinstance(target, ast.Subscript):
        target = target.value
    return str(getattr(target, "id", getattr(target, "attr", "")))


def _is_prose(node: ast.AST) -> TypeGuard[ast.expr]:
    return isinstance(node, ast.Constant) and bool(_PROSE.fullmatch(str(node.value)))


def _is_logged(function: ast.expr) -> bool:
    return isinstance(function, ast.Attribute) and getattr(function.value, "id", "") == "_log"


def _says(name: str) -> bool:
    return name in SAID_BY_NAME or name.strip("_").lower() in SAID_BY_NAME
