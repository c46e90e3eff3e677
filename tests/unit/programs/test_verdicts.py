"""What a page is told of points and files: a word for each reason, the place of a fault, and never a folder."""

import re
from typing import Any

import pytest

from cellcal.service.engineering.programs import point_checks
from cellcal.service.engineering.programs.postures import (
    NO_POSTURE,
    OTHER_CONFIGURATION,
    OTHER_TURNS,
    UNREACHABLE,
)
from cellcal.service.engineering.programs.verdicts import VERDICTS, place_in, verdict_of
from cellcal.service.path_redaction import without_paths


def test_every_reason_has_its_verdict() -> None:
    reason_codes = {
        "": "fits",
        UNREACHABLE: "reach",
        OTHER_CONFIGURATION: "reach",
        OTHER_TURNS: "limit",
        NO_POSTURE: "unknown",
        "no tool 3 in project.toml": "unknown",
    }
    assert {reason: verdict_of(reason) for reason in reason_codes} == reason_codes
    words = [
        const
        for function in (
            point_checks.TransferChecks.check_points,
            point_checks.TransferChecks._check_limits,
            point_checks.TransferChecks._check_flips,
            point_checks.TransferChecks._check_configurations,
        )
        for const in _words_of(function.__code__)
    ]
    words += _words_of(point_checks._describe_contact.__code__)
    beginnings = [
        word for word in words if re.match(r"(unreach|near a|joint |the wrist|collides|comes too)", word)
    ]
    assert {verdict_of(word) for word in beginnings} == set(VERDICTS) - {"fits", "unknown"}


def _words_of(code: Any) -> list[str]:
    found = [const for const in code.co_consts if isinstance(const, str)]
    return found + [
        word for const in code.co_consts if hasattr(const, "co_consts") for word in _words_of(const)
    ]


@pytest.mark.parametrize(
    ("sentence", "shown"),
    [
        (
            "near a singularity: 0.0040 m/rad, at least 0.01",
            "near a singularity: 0.0040 m/rad, at least 0.01",
        ),
        ("/home/a b/projects/x.toml: no alignment", "x.toml: no alignment"),
        ("../cell_1/project.toml holds", "cell_1/project.toml holds"),
        ("/x/clone/project.toml is of /x/cell/project.toml", "clone/project.toml is of cell/project.toml"),
        ("see (/a/b/c.toml) and '/d/e.json'", "see (c.toml) and 'e.json'"),
        ("a listing must not be edited in /POS.", "a listing must not be edited in /POS."),
        ("sources/A.LS:3:2: bad", "A.LS:3:2: bad"),
    ],
)
def test_sentences_keep_names_and_lose_folders(sentence: str, shown: str) -> None:
    assert without_paths(sentence) == shown


def test_a_refusal_begins_with_its_place() -> None:
    place = place_in("36:2: this is not understood: 1:2: x")
    assert (place.line, place.column, place.sentence) == (36, 2, "this is not understood: 1:2: x")
    assert place_in("the file is empty.").line == 0
