"""A folder that is no folder of programs is refused before it is read for hours."""

from pathlib import Path

import pytest

from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.service.engineering.programs import folders


def test_paths_below_a_folder_are_sorted_and_a_whole_disk_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["a.ls", "b", "b/c.ls"]
    (tmp_path / "b").mkdir()
    for name in ("b/c.ls", "a.ls"):
        (tmp_path / name).touch()
    assert folders.paths_below(tmp_path) == [tmp_path / name for name in names]
    monkeypatch.setattr(folders, "_MOST_PATHS", 2)
    with pytest.raises(ProgramFileError) as refused:
        folders.paths_below(tmp_path)
    assert "more than 2 files are below this folder" in str(refused.value)
    assert "Name the folder of the programs." in str(refused.value)
