"""The sentences that errors, rules and reasons are made of, found in the source: literals, holes numbered.

``make_message("{name}: the wire is {length_m:.3f} m long.", ...)``, like an f-string, is
``"{1}: the wire is {2} m long."``, wherever it is said.
"""

import ast
import contextlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from string import Formatter
from typing import NamedTuple, TypeGuard

ROOT = Path(__file__).parents[2]
SENTENCE = re.compile(r"(?<=[.?!])\s+")  # as in web/src/lib/say.svelte.ts
# Names of arguments, constants, fields and functions whose texts are read by people.
_BY_NAME = """
    TASK access_rule advice after descriptions attitude_forms alarm_text alike_text amount any_amount
    any_increment assumed assumption_texts
    barred_computed barred_different barred_moved barred_reason barred_set beside_external called caller
    camera chain_flaw chain_flaws clean_text collision_text compare_mastering component_set computed
    conflicts copied costs costs_each_time cure cure_text describe_hypothesis describe_mismatch
    describe_obstacle describe_parameter describe_partner describe_time describe_turn detectable detected_by
    different direction_text element_set external external_offset external_tool failure_reason figure_text
    figures find_trouble fixed flaw format_deviation forms frame_alone hindrances in_master in_script
    in_tool increment insert_event inside kind_texts lacks later led_motion limits_from limits_text made_by
    make_forecast message missing_group missing_need_texts move_text next_instruction no_exchange no_posture
    none_to_spare not_checked not_read not_verified offer_texts on_conveyor other_configuration other_frame
    other_group other_joints other_motion other_turns otherwise problem progress_text quantity_names
    question question_text reason reasons redo_question relative_axes remarks remedy rule saving_text
    saving_texts scale seen_from_flange sentence set_here several shared shortfall_text size_unreadable
    standing_tool star_unknown state_flaw status stray suggest_measurement suggest_rotation summary
    suspects_text text tips titled_keys to_sign trouble unpaired_text unreachable unseen unused unused_alone
    variable_amount what what_is_wrong what_moves why words written_remote
"""
# What is called with a text that is read by people, beside every error.
_CALLED = """
    Alarm CellAlarm Characteristic CheckedDocument Condition LimitExcess MessageFlaw Prediction SetAside
    TouchDecision ValueChange __init__ _archive_error _change_error _json_error _refuse_request
    _refused_error _row_reason _table_error _toml_error _unreadable_document _unreadable_error _xml_error
    bar_row damaged_error damaged_file_error drop_coordinates error error_at judge_value quantity_at_least
    quantity_at_most
    known_within make_error name_flaw refused_error row_error state_evidence state_fact state_figure
    unreadable_answer_error unreadable_error
"""
# Calls with (where, code, text) of a line of a program.
_REMARKS = "Remark _element_remarks _grouped_remarks _line_remarks _of_functions add_remark"
# What is called with words that no page shows: they are for a database, a log, a device or a program.
_UNSPOKEN = """
    Field MetricFamily RobotFiles _ask_dashboard _drop _query_rows _require_that _say _write_transaction add_note
    execute finish_job log_event post print response_options say startswith
"""
UNSPOKEN = frozenset(_UNSPOKEN.split())
_WORD = re.compile(r"[(\"']?[A-Za-z]?[a-z'-]+[)\"',.;:?!]*")
_LOGS = ("_log", "_LOG", "logging.getLogger")
_FEWEST_WORDS = 3  # of prose: names and keys have fewer
SAID_BY_NAME, SAYING = frozenset(_BY_NAME.split()), frozenset(_CALLED.split())
INSTRUCTION_CLASSES = frozenset(
    ("Instruction", "Question", "MeterReading", "Lint")
)  # a key or a code, and what is said
REMARKING = frozenset(_REMARKS.split())
_PROSE = re.compile(
    r"(?:[^\s\\|]+\s){2,}[^\\|]*[.]"
)  # three words and a full stop, in a table: no expression
_HOLE = re.compile(r"\{\w+\}")
_OPEN = re.compile(r"\{(?:[a-z]\w*)?(?:![rsa])?(?::[^{}]*)?\}")  # what `format` fills in later
_NAMED_HOLE = re.compile(r"(?<!\{)\{[a-z_]\w*(?:![rsa])?(?::[^{}]*)?\}")
_CODE = re.compile(r"[a-z_]+(\.[a-z_{}0]+)+")  # of an error or alarm: told to programs


class SourceTexts(NamedTuple):
    """What a file says, and its literals."""

    sentences: frozenset[str]
    """Of its errors, remedies, rules and reasons, sentence by sentence."""
    templates: tuple[tuple[int, str], ...]
    """Line and template, without formats, of each message."""
    passed: frozenset[str]
    """Prose that any function is called with, sentence by sentence."""
    literals: tuple[str, ...]
    f_strings: tuple[tuple[int, str], ...]
    """Line and text of each f-string, every hole written ``{0}``."""


@cache
def read_source(path: Path) -> SourceTexts:
    """Return the texts of a file, whose syntax tree is made once: it takes longer than all that is read from it."""
    sentences, passed, templates = set[str](), set[str](), list[tuple[int, str]]()
    literals, f_strings = list[str](), list[tuple[int, str]]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        sentences |= set(_sentences_of(node))
        passed |= set(_passed_prose(node))
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            literals.append(node.value)
        elif isinstance(node, ast.JoinedStr):
            f_strings.append((node.lineno, _text_of(node)))
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "make_message":
            templates += ((node.lineno, _plain_template(each)) for each in _literals_of(node.args[0]))
    return SourceTexts(
        frozenset(sentences), tuple(templates), frozenset(passed), tuple(literals), tuple(f_strings)
    )


def _sentences_of(node: ast.AST) -> Iterator[str]:
    for expression in _sentence_expressions(node):
        for template in expression_texts(expression):
            for part in SENTENCE.split(template):
                if _HOLE.sub("", part).strip(" .,:;'") and not _CODE.fullmatch(part):
                    yield number_holes(part)


def _passed_prose(node: ast.AST) -> Iterator[str]:
    """Yield each sentence of a call's arguments: a function with any name may say it to people."""
    if not isinstance(node, ast.Call) or _called_name(node) in UNSPOKEN or _is_logged(node.func):
        return
    arguments = (*node.args, *(each.value for each in node.keywords))
    for addend in (each for argument in arguments for each in _addends(argument)):
        for template in expression_texts(addend):
            for part in SENTENCE.split(template):
                if sum(_WORD.fullmatch(word) is not None for word in part.split()) >= _FEWEST_WORDS:
                    yield number_holes(part)


def _addends(node: ast.expr) -> Iterator[ast.expr]:
    """Yield what a text is put together of by ``+``."""
    if isinstance(node, ast.BinOp):
        yield from _addends(node.left)
        yield from _addends(node.right)
    else:
        yield node


def _called_name(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def _text_of(node: ast.JoinedStr) -> str:
    return "".join(
        part.value if isinstance(part, ast.Constant) and isinstance(part.value, str) else "{0}"
        for part in node.values
    )


def number_holes(part: str) -> str:
    """Return a sentence with its holes counted from one, and no space around it."""
    count = iter(range(1, 100))
    numbered = _HOLE.sub(lambda _: f"{{{next(count)}}}", part.strip())
    return numbered.replace("{{", "{").replace("}}", "}")  # braces that are no holes


def constant_templates(path: Path) -> Iterator[str]:
    """Yield the constants of a file that have named holes: templates that are used by name, or in a table."""
    for literal in read_source(path).literals:
        if _NAMED_HOLE.search(literal):
            with contextlib.suppress(ValueError):
                yield _plain_template(literal)


def _literals_of(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.IfExp):
        yield from _literals_of(node.body)
        yield from _literals_of(node.orelse)
    elif isinstance(node, ast.Constant):
        yield str(node.value)


def _plain_template(template: str) -> str:
    count = iter(range(1, 100))
    parts = Formatter().parse(template)
    return "".join(
        literal.replace("{", "{{").replace("}", "}}") + ("" if name is None else f"{{{name or next(count)}}}")
        for literal, name, _, _ in parts
    )


def expression_texts(node: ast.expr) -> Iterator[str]:
    """Return what an expression may say; nothing where that is not written here."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield _OPEN.sub("{0}", node.value)
    elif isinstance(node, ast.JoinedStr):
        yield _OPEN.sub("{0}", _text_of(node))
    elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "make_message":
        yield from expression_texts(node.args[0])
    elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "join_messages":
        yield from expression_texts(node.args[1])
    elif isinstance(node, ast.IfExp):
        yield from expression_texts(node.body)
        yield from expression_texts(node.orelse)
    elif isinstance(node, ast.Tuple | ast.List | ast.BoolOp):
        for each in node.values if isinstance(node, ast.BoolOp) else node.elts:
            yield from expression_texts(each)
    elif isinstance(node, ast.Dict):
        for each in node.values:
            yield from expression_texts(each)
    elif isinstance(node, ast.Starred | ast.DictComp | ast.Subscript):
        yield from expression_texts(node.value)
    elif isinstance(node, ast.GeneratorExp | ast.ListComp):
        yield from expression_texts(node.elt)


def _sentence_expressions(node: ast.AST) -> Iterator[ast.expr]:
    if isinstance(node, ast.Call):
        name = _called_name(node)
        if name.endswith("Error") or (name in SAYING and not _is_logged(node.func)):
            yield from node.args
        elif name in REMARKING:
            yield from node.args[2:]
        elif name in INSTRUCTION_CLASSES:
            yield from node.args[1:2]
        yield from (each.value for each in node.keywords if each.arg in SAID_BY_NAME)
    elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
        names = node.targets if isinstance(node, ast.Assign) else [node.target]
        target_names = [_assigned_name(name) for name in names]
        if any(_is_sentence_name(name) for name in target_names):
            yield node.value
        elif target_names[0].isupper():
            yield from (each for each in ast.walk(node.value) if _is_prose(each))
    elif isinstance(node, ast.Dict):
        yield from (
            value
            for key, value in zip(node.keys, node.values, strict=True)
            if isinstance(key, ast.Constant) and key.value in SAID_BY_NAME
        )
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and _is_sentence_name(node.name):
        yield from (each.value for each in ast.walk(node) if isinstance(each, ast.Return) and each.value)


def _assigned_name(target: ast.expr) -> str:
    """Return the name that is assigned to, of a table's element the table's."""
    while isinstance(target, ast.Subscript):
        target = target.value
    return str(getattr(target, "id", getattr(target, "attr", "")))


def _is_prose(node: ast.AST) -> TypeGuard[ast.expr]:
    return isinstance(node, ast.Constant) and bool(_PROSE.fullmatch(str(node.value)))


def _is_logged(function: ast.expr) -> bool:
    return isinstance(function, ast.Attribute) and ast.unparse(function.value).startswith(_LOGS)


def _is_sentence_name(name: str) -> bool:
    return name in SAID_BY_NAME or name.strip("_").lower() in SAID_BY_NAME
