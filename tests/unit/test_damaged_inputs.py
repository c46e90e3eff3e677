"""Damaged files of every kind are read or refused in words: a slice of the campaign ``inputs``."""

from pathlib import Path

from tests.soak.input_doors import file_doors
from tests.soak.inputs import Findings, try_input


def test_no_damaged_input_ends_in_a_trace(tmp_path: Path) -> None:
    found = Findings()
    for door in file_doors(tmp_path):
        for seed in range(100_000, 100_012):
            try_input(door, tmp_path, seed, found)
    assert found.flaws == []
    assert found.read > 20  # the damage is not so heavy that no reader is passed


def test_damage_that_once_ended_in_a_trace(tmp_path: Path) -> None:
    found = Findings()
    for door in file_doors(tmp_path):
        for seed in {"URDF": [1355], "report as parameters": [1880]}.get(door.name, []):
            try_input(door, tmp_path, seed, found)
    assert found.cases == 2
    assert found.flaws == []
