"""What a cell keeps is for its owner only, whatever the umask says; what a Host header may be."""

import errno
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from cellcal.service.export.archive import BackupError, write_archive
from cellcal.service.files import create_file, create_private_file, make_private_folder, replace_file
from cellcal.service.path_redaction import without_paths
from cellcal.service.people.pin_hashing import pepper_of
from cellcal.service.record.journal import Journal
from cellcal.service.record.signing import station_key
from cellcal.service.times import read_time
from cellcal.service.web.middleware import _host_name


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o777])
def test_files_are_for_their_owner_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        make_private_folder(tmp_path / "a" / "b")
        replace_file(tmp_path / "a" / "b" / "x", "text")
        create_private_file(tmp_path / "a" / "y")
        Journal.open_file(tmp_path / "c" / "journal.db").close()
    finally:
        os.umask(before)
    found = [
        tmp_path / "a",
        tmp_path / "a" / "b",
        tmp_path / "c",
        *tmp_path.glob("c/*"),
        *tmp_path.glob("a/*"),
    ]
    assert {path.stat().st_mode & 0o777 for path in found if path.is_dir()} == {0o700}
    assert {path.stat().st_mode & 0o777 for path in [*tmp_path.rglob("*")] if path.is_file()} == {0o600}


@pytest.mark.parametrize(
    ("header", "name"),
    [("Cell-7.Plant:8470", "cell-7.plant"), ("[::1]:80", "::1"), ("127.0.0.1", "127.0.0.1"), ("localhost:x", ""),
     ("localhost:99999", ""), ("[::1]evil", ""), ("[::1", ""), ("a b", ""), ("localhost:80:80", ""), ("", ""),
     ("user@localhost", ""), ("localhost/", ""), ("localhost:\u0661", ""), ("[::1]:0", "")],
)  # fmt: skip
def test_a_host_is_read_strictly(header: str, name: str) -> None:
    assert _host_name(header) == name


def test_a_time_without_a_zone_is_refused() -> None:
    assert read_time("2026-01-01T00:00:00+00:00").tzinfo is not None
    with pytest.raises(ValueError, match="no time zone"):
        read_time("2026-01-01T00:00:00")


def test_a_screen_learns_no_folder() -> None:
    assert without_paths("/srv/cells/7/cell.toml cannot be used") == "cell.toml cannot be used"


def _refuse_link(*_names: object) -> None:
    raise OSError(errno.EPERM, "Operation not permitted")


def test_of_many_that_create_a_file_where_no_hard_links_are_one_succeeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a stick with exFAT, where the system refuses hard links with EPERM."""
    monkeypatch.setattr(os, "link", _refuse_link)

    def create(number: int) -> bool:
        try:
            create_file(tmp_path / "v0001.toml", str(number).encode())
        except FileExistsError:
            return False
        return True

    with ThreadPoolExecutor(8) as pool:
        created = list(pool.map(create, range(40)))
    assert created.count(True) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["v0001.toml"]
    assert (tmp_path / "v0001.toml").read_text() == str(created.index(True))


def test_keys_peppers_and_archives_are_made_where_no_hard_links_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "link", _refuse_link)
    key = station_key(tmp_path)
    pepper = pepper_of(tmp_path)
    assert station_key(tmp_path).public_key == key.public_key
    assert pepper_of(tmp_path) == pepper
    write_archive(tmp_path / "a.tar", {}, {}, key)
    with pytest.raises(BackupError, match="is there already"):
        write_archive(tmp_path / "a.tar", {}, {}, key)
