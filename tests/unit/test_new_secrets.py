"""Keys and secrets that are written once: whole or not there, so that the next try succeeds."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from cellcal.service.cli.webhooks import secret
from cellcal.service.site.authority import write_new


@pytest.mark.parametrize("write", [secret, lambda path: write_new(path, b"key", 0o600)])
def test_a_full_disk_leaves_no_half_secret(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write: Callable[[Path], object]
) -> None:
    def refuse(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="No space"):
        write(tmp_path / "s.key")
    assert not (tmp_path / "s.key").exists()
    monkeypatch.undo()
    write(tmp_path / "s.key")
    assert (tmp_path / "s.key").stat().st_mode & 0o777 == 0o600
