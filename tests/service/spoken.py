"""The sentences that errors, rules and reasons are made of, found in the source: literals, holes numbered.

``f"{name}: the wire is {length_m:.3f} m long."`` is ``"{1}: the wire is {2} m long."``, wherever it is said.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SENTENCE = re.compile(r"(?<=[.?!])\s+")  # as in web/src/lib/say.svelte.ts
SAID_BY_NAME = frozenset({"remedy", "reason", "why", "advice", "rule", "message"})
SAYING = frozenset({"__init__", "Condition", "Judged", "SetAside", "Check", "Figure"})  # and every error
_HOLE = re.compile(r"\{\d+\}")


def sentences(path: Path) -> set[str]:
    """Return what a file's errors, remedies, rules and reasons say, sentence by sentence."""
    return {
        numbered(part)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for said in _said(node)
        for template in templates(said)
        for part in SENTENCE.split(template)
        if _HOLE.sub("", part).strip(" .,:;'")
    }


def numbered(part: str) -> str:
    """Return a sentence with its holes counted from one, and no space around it."""
    count = iter(range(1, 100))
    return _HOLE.sub(lambda _: f"{{{next(count)}}}", part.strip())


def templates(node: ast.expr) -> Iterator[str]:
    """Return what an expression may say; nothing where that is not written here."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{0}" for part in node.values)
    elif isinstance(node, ast.IfExp):
        yield from templates(node.body)
        yield from templates(node.orelse)


def _said(node: ast.AST) -> Iterator[ast.expr]:
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name.endswith("Error") or name in SAYING:
            yield from node.args
        yield from (each.value for each in node.keywords if each.arg in SAID_BY_NAME)
    elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
        names = node.targets if isinstance(node, ast.Assign) else [node.target]
        if any(isinstance(name, ast.Name) and name.id.strip("_").lower() in SAID_BY_NAME for name in names):
            yield node.value
