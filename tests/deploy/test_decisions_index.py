"""DECISIONS.md: the index lists every decision with its title and a status that names existing decisions."""

import re
from pathlib import Path

TEXT = (Path(__file__).parents[2] / "DECISIONS.md").read_text(encoding="utf-8")
HEADINGS = {int(number): title for number, title in re.findall(r"^## (\d+)\. (.+)$", TEXT, flags=re.M)}
ROWS = re.findall(r"^\| (\d+) \| (.+?) \| (.+?) \|$", TEXT, flags=re.M)


def test_the_index_lists_every_decision_once_under_its_own_title():
    assert sorted(int(number) for number, _, _ in ROWS) == sorted(HEADINGS)
    assert {int(number): title for number, title, _ in ROWS} == HEADINGS


def test_each_status_is_known_and_names_existing_decisions():
    for number, _, status in ROWS:
        assert re.match(r"in force|superseded by \d+", status), number
        assert {int(other) for other in re.findall(r"\d+", status)} <= set(HEADINGS), number
