"""Damaged files of every kind are read or refused in words: a slice of the campaign ``inputs``."""

from pathlib import Path

from tests.soak.input_readers import file_readers
from tests.soak.inputs import InputFindings, try_input


def test_no_damaged_input_ends_in_a_trace(tmp_path: Path) -> None:
    found = InputFindings()
    for reader in file_readers(tmp_path):
        for seed in range(100_000, 100_012):
            try_input(reader, tmp_path, seed, found)
    assert found.list_flaws == []
    assert found.read > 20  # the damage is not so heavy that no reader is passed


def test_damage_that_once_ended_in_a_trace(tmp_path: Path) -> None:
    found = InputFindings()
    for reader in file_readers(tmp_path):
        for seed in {"URDF": [1355], "report as parameters": [1880]}.get(reader.name, []):
            try_input(reader, tmp_path, seed, found)
    assert found.cases == 2
    assert found.list_flaws == []
