"""The restore drill: what comes back is what was kept, to the byte; what is damaged does not come back at all."""

import asyncio
import hashlib
import io
import json
import os
import random
import shutil
import sqlite3
import subprocess
import tarfile
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.errors import CellError
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.engineering.parameters.parameter_set import ParameterSet, ParameterValue
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.exit_codes import ExitCode
from cellcal.service.export import restore
from cellcal.service.export.archive import FORMAT, MANIFEST, BackupError
from cellcal.service.export.backup import back_up, forget_older
from cellcal.service.export.restore import prove_backup, restore_backup
from cellcal.service.people.accounts import AccountStore
from cellcal.service.people.pin_hashing import pepper_of
from cellcal.service.people.roles import Role
from cellcal.service.record.journal import NewEvent
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.signing import CellKey, station_key
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import user_frame_scene
from tests.service.service_client import cheap_hasher

PASSPHRASE = "seven wet towels"


def lived_in(folder: Path) -> CellConfig:
    """Return a cell with two certified runs, people, parameter sets, and what belongs to a moment."""
    folder.mkdir(exist_ok=True)
    config = cell_config(folder)
    data_dir = config.cell.data_dir
    for _ in range(2):
        issue_certificate(config, asyncio.run(run_in(config, user_frame_scene(), "three_point_frame")).run_id)
    register = AccountStore(data_dir)
    hasher = cheap_hasher(pepper_of(data_dir))
    register.hold_to_pepper(hasher.pepper_mark)
    register.add_person("Tom", Role.TECHNICIAN, hasher.hash_secret("314159"), "test")
    draft = ParameterSet(
        "F-1", "m", "0", "2026-01-01T00:00:00Z", "anna", "test", (ParameterValue("a1", "m", 1e-4, 1e-5),)
    )
    ParameterSets(folder / "parameter_sets").save_draft(draft)
    (data_dir / "last_healthy_fanuc.json").write_text('{"robot": "fanuc", "counts": [1], "epoch": 1}')
    (data_dir / "shown_position_abb.json").write_text('{"robot": "abb", "lost": ["2026-01-01", "SRVO", [1]]}')
    (data_dir / "under_way.json").write_text("{}")
    (data_dir / "site_outbox.sqlite").write_text("numbers that must not be said twice")
    (data_dir / "programs").mkdir()
    (data_dir / "programs" / "A.LS").write_text("/PROG A")
    (data_dir / "link").symlink_to("/etc/passwd")
    return config


def folder_contents(folder: Path) -> dict[str, str]:
    """Return the hash of every plain file; of databases, of what they hold."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink() and not path.name.endswith((".lock", "-wal", "-shm")):
            content = _dump_database(path) if path.suffix == ".db" else path.read_bytes()
            found[path.relative_to(folder).as_posix()] = hashlib.sha256(content).hexdigest()
    return found


def _dump_database(path: Path) -> bytes:
    with closing(sqlite3.connect(path)) as database:
        return "\n".join(database.iterdump()).encode()


def test_the_drill(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = lived_in(tmp_path / "old")
    phrase = tmp_path / "phrase"
    phrase.write_text(PASSPHRASE + "\n")
    phrase.chmod(0o600)
    backups = tmp_path / "backups"
    backups.mkdir()
    before = folder_contents(tmp_path / "old")
    arguments = [
        "backup",
        str(config.path),
        "--to",
        str(backups),
        "--keys",
        "--passphrase-file",
        str(phrase),
        "--json",
    ]
    assert run_command_line(arguments) == 0
    output = json.loads(capsys.readouterr().out)
    assert (output["certificates"], output["has_keys"], output["left_out"]) == (2, True, ["link"])
    assert Path(output["path"]).stat().st_mode & 0o077 == 0
    shutil.rmtree(tmp_path / "old")

    new = tmp_path / "new" / "cell.toml"
    assert run_command_line(["restore", output["path"], "--check"]) == 0
    back = ["restore", output["path"], str(new), "--keys", "--passphrase-file", str(phrase)]
    signer = prove_backup(Path(output["path"])).public_key
    assert run_command_line(back) == run_command_line([*back, "--signed-by", "0" * 64]) == ExitCode.SIGNATURE
    assert f"--signed-by {signer}" in capsys.readouterr().err.replace("\n", " ")
    assert not new.exists()
    assert run_command_line([*back, "--signed-by", signer]) == 0
    assert not config.cell.data_dir.exists()  # the cell file in the backup named it with its whole path
    after = folder_contents(new.parent)
    assert after.pop("cell.toml") != before.pop("cell.toml")  # its data_dir is the folder beside it now
    assert read_cell_file(new).cell.data_dir == new.parent / "data"
    for gone in ("data/under_way.json", "data/site_outbox.sqlite"):
        before.pop(gone)
    assert after == before
    again = read_cell_file(new)
    with open_journal(again) as journal:
        assert journal.verify_chain() is None
        journal.append_all("later", [NewEvent("finding", {"step": "x", "value": 1})])  # it goes on
    for path in (again.cell.data_dir / "certificates").glob("*.json"):
        key = station_key(again.cell.data_dir).public_key
        assert run_command_line(["verify", str(path), "--key", key]) == 0
    for name in ("signing_key.pem", "pepper.key"):
        assert (again.cell.data_dir / name).stat().st_mode & 0o077 == 0
    tom = AccountStore(again.cell.data_dir).list_people()[0]
    assert cheap_hasher(pepper_of(again.cell.data_dir)).is_right(tom.pin_hash, "314159")
    assert ParameterSets(new.parent / "parameter_sets").load_set("F-1").find_value("a1") is not None
    assert not list(new.parent.glob(".cellcal*"))


def test_any_damage_is_refused_whole(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    archive = back_up(config, tmp_path / "kept").path
    whole = archive.read_bytes()
    rng = random.Random(3)
    spots = [0, len(whole) - 1, 200, 513, *(rng.randrange(len(whole)) for _ in range(40))]
    spoilt = [whole[:at] + bytes([whole[at] ^ (1 << rng.randrange(8))]) + whole[at + 1 :] for at in spots]
    spoilt += [whole[: rng.randrange(len(whole))] for _ in range(10)] + [b"", whole + b"\n", whole[1:]]
    target = tmp_path / "new" / "cell.toml"
    for content in spoilt:
        archive.write_bytes(content)
        with pytest.raises(BackupError) as refused:
            restore_backup(archive, target)
        assert refused.value.code == "store.damaged"
        assert list((tmp_path / "new").iterdir()) == []
    archive.write_bytes(whole)
    assert prove_backup(archive).certificates == 2
    shown = subprocess.run(["tar", "-tf", archive], capture_output=True, text=True, check=True)
    assert shown.stdout.splitlines()[0] == MANIFEST


def test_a_pipe_or_a_huge_file_of_another_kind_is_refused_at_once(tmp_path: Path) -> None:
    pipe, huge = tmp_path / "a.cellcal-backup", tmp_path / "b.cellcal-backup"
    os.mkfifo(pipe)
    with huge.open("wb") as file:
        file.truncate(1 << 42)  # it takes no room; to read it would take hours
    for path, why in ((pipe, "not a plain file"), (huge, "does not begin with manifest.json")):
        with pytest.raises(CellError, match=why):
            prove_backup(path)


Forge = Callable[[dict[str, bytes]], None]


def forge_archive(archive: Path, key: CellKey, change: Forge, names: Callable[[str], str] = str) -> None:
    """Write an archive anew with another content, and all hashes, the list and the end made to fit."""
    with tarfile.open(archive) as tar:
        files = {one.name: tar.extractfile(one).read() for one in tar.getmembers()}  # type: ignore[union-attr]
    content: dict[str, Any] = json.loads(files.pop(MANIFEST))["content"]
    change(files)
    content["files"] = [
        {"path": names(name), "bytes": len(raw), "sha256": hashlib.sha256(raw).hexdigest()}
        for name, raw in files.items()
    ]
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as tar:
        for name, raw in {MANIFEST: key.sign_document(FORMAT, content).encode(), **files}.items():
            header = tarfile.TarInfo(names(name) if name != MANIFEST else name)
            header.size = len(raw)
            tar.addfile(header, io.BytesIO(raw))
    archive.write_bytes(packed.getvalue() + hashlib.sha256(packed.getvalue()).hexdigest().encode() + b"\n")


def _rewrite_journal(files: dict[str, bytes]) -> None:
    files["data/journal.db"] = files["data/journal.db"].replace(b"three_point_frame", b"three_point_flame")


def _rewrite_certificate(files: dict[str, bytes]) -> None:
    name = next(name for name in files if name.startswith("data/certificates/") and name.endswith(".json"))
    files[name] = files[name].replace(b'"pass"', b'"fail"')


def test_a_drill_fails_where_no_cell_could_be_put_back_from_it(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    archive = back_up(config, tmp_path / "kept").path
    forge_archive(archive, station_key(tmp_path / "stranger"), lambda files: files.update({"cell.toml": b""}))
    with pytest.raises(CellError):
        prove_backup(archive)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (_rewrite_journal, "its journal does not hold"),
        (_rewrite_certificate, "is no certificate as it was signed"),
        (lambda files: files.pop("data/journal.db"), "its journal or its cell file is missing"),
    ],
)
def test_consistent_hashes_do_not_allow_rewriting_what_is_chained_or_signed(
    tmp_path: Path, change: Forge, what: str
) -> None:
    config = lived_in(tmp_path / "old")
    archive = back_up(config, tmp_path / "kept").path
    stranger = station_key(tmp_path / "stranger")
    forge_archive(archive, stranger, lambda files: None)
    assert (
        prove_backup(archive).public_key
        == stranger.public_key
        != station_key(config.cell.data_dir).public_key
    )
    forge_archive(archive, stranger, change)
    with pytest.raises(BackupError, match=what):
        restore_backup(archive, tmp_path / "new" / "cell.toml")


@pytest.mark.parametrize(
    "evil",
    [
        "../evil",
        "/etc/evil",
        "data/../../evil",
        "data\\evil",
        "data/\x1b[31m",
        "data//x",
        "data/signing_key.pem",
        "data/pepper.key",
        "data/programs/.. /x",
        "data/site/ca.key",
        ".bashrc",
        "parameter_sets/x.py",
    ],
)
def test_no_name_leads_out_of_the_folder(tmp_path: Path, evil: str) -> None:
    config = lived_in(tmp_path / "old")
    archive = back_up(config, tmp_path / "kept").path
    forge_archive(
        archive, station_key(tmp_path / "stranger"), lambda files: None,
        names=lambda name: evil if name == "data/programs/A.LS" else name,
    )  # fmt: skip
    with pytest.raises(BackupError, match="files that no backup has"):
        restore_backup(archive, tmp_path / "new" / "cell.toml")
    assert not (tmp_path / "evil").exists()


def test_nothing_is_ever_put_over_what_is_there(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    archive = back_up(config, tmp_path / "kept").path
    before = folder_contents(tmp_path / "old")
    with pytest.raises(BackupError, match="is in the way"):
        restore_backup(archive, config.path, signed_by=prove_backup(archive).public_key)
    assert folder_contents(tmp_path / "old") == before
    with pytest.raises(BackupError, match="there already"):
        back_up(config, archive)
    (tmp_path / "other").mkdir()
    other = cell_config(tmp_path / "other")
    other.path.write_text(other.text.replace(config.cell.name, "another"))
    with pytest.raises(BackupError, match="the backup is of"):
        restore_backup(archive, other.path)


@pytest.mark.parametrize("moves_before", [1, 2])
def test_a_restore_that_was_killed_is_gone_on_with_by_the_same_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves_before: int
) -> None:
    archive = back_up(lived_in(tmp_path / "old"), tmp_path / "kept").path
    key, new = prove_backup(archive).public_key, tmp_path / "new"
    move, count = restore._move_file, 0

    def move_some(source: Path, target: Path) -> None:
        nonlocal count
        count += 1
        if count > moves_before:
            raise KeyboardInterrupt  # a kill: nothing is taken back
        move(source, target)

    monkeypatch.setattr(restore, "_move_file", move_some)
    with pytest.raises(KeyboardInterrupt):
        restore_backup(archive, new / "cell.toml", signed_by=key)
    assert not (new / "cell.toml").exists()
    monkeypatch.undo()
    restore_backup(archive, new / "cell.toml", signed_by=key)
    restore_backup(archive, tmp_path / "whole" / "cell.toml", signed_by=key)
    assert folder_contents(new) == folder_contents(tmp_path / "whole")
    with pytest.raises(BackupError, match="is in the way"):
        restore_backup(archive, new / "cell.toml", signed_by=key)


def test_keys_are_there_for_whom_they_are_for(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    bare, sealed = (
        back_up(config, tmp_path / "bare").path,
        back_up(config, tmp_path / "sealed", PASSPHRASE).path,
    )
    secret = (config.cell.data_dir / "signing_key.pem").read_bytes(), pepper_of(config.cell.data_dir)
    for archive in (bare, sealed):
        assert not any(each in archive.read_bytes() for each in secret)
    with pytest.raises(CellError, match="another passphrase"):
        restore_backup(sealed, tmp_path / "new" / "cell.toml", "seven dry towels")
    with pytest.raises(CellError, match="no keys in this backup"):
        restore_backup(bare, tmp_path / "new" / "cell.toml", PASSPHRASE)
    with pytest.raises(CellError, match="at least 12"):
        back_up(config, tmp_path / "short", "12345")
    shutil.rmtree(config.cell.data_dir)
    target = tmp_path / "new" / "cell.toml"
    assert not restore_backup(sealed, target, signed_by=prove_backup(sealed).public_key).keys_opened
    assert not list(target.parent.rglob("*.pem"))


def test_a_damaged_cell_makes_no_backup_that_looks_good(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    certificate = next((config.cell.data_dir / "certificates").glob("*.json"))
    good = certificate.read_bytes()
    certificate.write_bytes(good.replace(b'"pass"', b'"fail"'))
    with pytest.raises(BackupError, match="no certificate as it was signed"):
        back_up(config, tmp_path / "kept")
    certificate.write_bytes(good)
    with closing(sqlite3.connect(journal_path(config), isolation_level=None)) as database:
        database.execute("UPDATE event SET body = '{}' WHERE seq = 5")
    with pytest.raises(BackupError, match="damaged after event 4"):
        back_up(config, tmp_path / "kept")
    assert not list(tmp_path.glob("kept*"))


def test_a_backup_of_a_journal_that_grows_is_one_moment_of_it(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    done = threading.Event()

    def grow_journal() -> None:
        with open_journal(config) as journal:
            for k in range(100):
                journal.append_all("busy", [NewEvent("finding", {"step": f"s{k}", "value": k})])
        done.set()

    writer = threading.Thread(target=grow_journal)
    writer.start()
    made = []
    while not done.is_set() or not made:
        made.append(back_up(config, tmp_path / f"kept-{len(made)}"))
    writer.join()
    made.append(back_up(config, tmp_path / "last"))
    assert (
        [prove_backup(one.path).events for one in made]
        == [one.events for one in made]
        == sorted(o.events for o in made)
    )
    with open_journal(config) as journal:
        assert made[-1].events == len(journal.list_events())


def test_only_the_newest_are_kept_and_only_of_this_cell(tmp_path: Path) -> None:
    config = lived_in(tmp_path / "old")
    named = back_up(config, tmp_path).path
    stem = named.name.split("-2")[0]
    older = [tmp_path / f"{stem}-202601{day:02d}T000000Z.cellcal-backup" for day in range(1, 6)]
    foreign = tmp_path / "other-20260101T000000Z.cellcal-backup"
    for path in (*older, foreign):
        path.write_text("x")
    assert forget_older(config, tmp_path, 3) == older[:3]
    assert sorted(tmp_path.glob("*.cellcal-backup")) == sorted([*older[3:], foreign, named])
    assert (
        run_command_line(["backup", str(config.path), "--to", str(tmp_path), "--keep", "0"]) == ExitCode.USAGE
    )
