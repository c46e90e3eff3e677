"""The map of what the pages promise is whole: every feature is in it, and every test that it names is there."""

import ast
import tomllib
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
FEATURES: dict[str, dict[str, list[str] | str]] = tomllib.loads((TESTS / "features.toml").read_text("utf-8"))
NOT_TESTED = "not held: "


def named_in(path: Path) -> set[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return {node.name for node in found if node.name.startswith("test_")}


def test_every_feature_is_in_the_map() -> None:
    assert list(FEATURES) == [f"U{k}" for k in range(1, 28)]


@pytest.mark.parametrize("feature", FEATURES)
def test_every_criterion_names_tests_that_there_are_or_says_why_none_does(feature: str) -> None:
    assert any(isinstance(proof, list) for proof in FEATURES[feature].values()), "nothing of it is proved"
    for criterion, proof in FEATURES[feature].items():
        if isinstance(proof, str):
            assert proof.startswith(NOT_TESTED), criterion
            assert len(proof) > len(NOT_TESTED) + 20, f"no reason is given: {criterion}"
            continue
        assert proof, criterion
        for named in proof:
            file, _, test = named.partition("::")
            assert test in named_in(TESTS / file), f"{criterion}: no such test: {named}"
