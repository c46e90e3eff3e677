"""Archives by strangers: what `tarfile` and SQLite would do by themselves is refused before it happens."""

import hashlib
import io
import sqlite3
import tarfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from cellcal.service.export.archive import MANIFEST, BackupError
from cellcal.service.export.backup import back_up
from cellcal.service.export.restore import prove_backup
from cellcal.service.record.signing import station_key
from tests.service.test_backup import forge_archive, lived_in


def _sparse_terabyte(header: tarfile.TarInfo) -> bytes:
    header.pax_headers = {"GNU.sparse.size": str(1 << 40), "GNU.sparse.map": "0,1"}
    return b"x"


def _many_extensions(header: tarfile.TarInfo) -> bytes:
    header.type = tarfile.XHDTYPE
    return b"11 foo=bar\n"


def _link_abroad(header: tarfile.TarInfo) -> bytes:
    header.type, header.linkname = tarfile.LNKTYPE, "/etc/passwd"
    return b""


@pytest.mark.parametrize(
    ("write_member", "count", "why"),
    [
        (_sparse_terabyte, 1, "an extension that no backup has"),
        (_many_extensions, 3000, "an extension that no backup has"),
        (_link_abroad, 1, "is no plain file"),
    ],
)
def test_headers_that_our_writer_never_writes_are_refused_before_a_byte_is_unpacked(
    tmp_path: Path, write_member: Callable[[tarfile.TarInfo], bytes], count: int, why: str
) -> None:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar:
        manifest = tarfile.TarInfo(MANIFEST)
        tar.addfile(manifest)
        for _ in range(count):
            header = tarfile.TarInfo("data/journal.db")
            content = write_member(header)
            header.size = len(content)
            tar.addfile(header, io.BytesIO(content))
    archive = tmp_path / "a.cellcal-backup"
    archive.write_bytes(packed.getvalue() + hashlib.sha256(packed.getvalue()).hexdigest().encode() + b"\n")
    with pytest.raises(BackupError, match=why):
        prove_backup(archive)


@pytest.mark.parametrize(
    ("name", "sql"),
    [
        ("data/journal.db", "CREATE VIEW more AS WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n FROM c) SELECT n FROM c"),
        ("data/people.db", "CREATE TRIGGER boss AFTER INSERT ON person BEGIN UPDATE person SET role = 'admin'; END"),
    ],
)  # fmt: skip
def test_a_database_that_acts_by_itself_is_refused(tmp_path: Path, name: str, sql: str) -> None:
    def add_rule(files: dict[str, bytes]) -> None:
        path = tmp_path / "forged.db"
        path.write_bytes(files[name])
        with closing(sqlite3.connect(path)) as database, database:
            database.execute(sql)
        files[name] = path.read_bytes()

    archive = back_up(lived_in(tmp_path / "old"), tmp_path / "kept").path
    forge_archive(archive, station_key(tmp_path / "stranger"), add_rule)
    with pytest.raises(BackupError, match=r"it holds the (view|trigger)"):
        prove_backup(archive)
