"""A figure of statistics is shown with what its number means, on pages and certificates."""

import ast
import re
from collections.abc import Iterator

from tests.service.source_sentences import ROOT

STATISTIC = re.compile(r"chi_square|probability")
EXPLAINED = re.compile(r"\b(chi_square|chance)_rule\(")


def judged_statistics() -> Iterator[tuple[str, str]]:
    """Yield where a chi square or a chance is judged, and the source of its rule."""
    for file in sorted((ROOT / "procedures").rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        tree = ast.parse(source)
        named = {
            target.id: ast.unparse(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Assign)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
                continue
            found = [ast.unparse(each.value) for each in node.keywords if each.arg == "found"]
            if node.func.id in ("state_fact", "state_evidence") and found and STATISTIC.search(found[0]):
                rule = ast.unparse(node.args[2])
                yield f"{file.relative_to(ROOT)}:{node.lineno}", named.get(rule, rule)


def test_every_chi_square_and_every_chance_says_what_the_number_means() -> None:
    judged = list(judged_statistics())
    assert len(judged) >= 9
    assert not [where for where, rule in judged if not EXPLAINED.search(rule)]
