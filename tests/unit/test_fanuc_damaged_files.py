"""Damaged files of a controller: refused, or the record is right all the same; never a crash, never a wrong angle."""

from collections import Counter
from pathlib import Path

from tests.unit.helpers.fanuc_mutations import judge_damage

DAMAGES = 250


def test_no_damage_of_one_file_makes_a_wrong_record(tmp_path: Path) -> None:
    found = Counter(judge_damage(tmp_path, seed) for seed in range(DAMAGES))
    assert not found.keys() - {"refused", "harmless"}
    assert found["refused"] > DAMAGES // 5  # the test damages what matters
    assert found["harmless"] > DAMAGES // 5
