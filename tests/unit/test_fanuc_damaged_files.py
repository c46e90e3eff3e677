"""Damaged files of a controller: refused, or the record is right all the same; never a crash, never a wrong angle."""

import re
from collections import Counter
from pathlib import Path

import pytest

from cellcal.drivers.fanuc.controller_files.controller_files import read_controller_files
from cellcal.drivers.fanuc.controller_files.file_sources import FolderSource
from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.service.engineering.controller_files.record_checks import ControllerRecordError
from cellcal.service.engineering.controller_files.record_from_files import make_records
from tests.unit.helpers.fanuc_mutations import judge_damage
from tests.wire.fanuc_ftp import save_backup

DAMAGES = 250


def test_no_damage_of_one_file_makes_a_wrong_record(tmp_path: Path) -> None:
    found = Counter(judge_damage(tmp_path, seed) for seed in range(DAMAGES))
    assert not found.keys() - {"refused", "harmless"}
    assert found["refused"] > DAMAGES // 5  # the test damages what matters
    assert found["harmless"] > DAMAGES // 5


@pytest.mark.parametrize(
    ("counts", "without", "reason"),
    [
        (524_288, "", r"J2 by -1\."),
        (-2 * 524_288, "curpos.dg", r"J2 by \+2\."),
        (5_000, "curpos.dg", "may be of two moments"),
        (5_000, "", ""),
        (1, "curpos.dg", ""),
    ],
)
def test_counts_that_the_controller_noted_bind_those_that_it_shows(
    tmp_path: Path, counts: int, without: str, reason: str
) -> None:
    """Shown angles come from the same counts as the record: whole turns that were lost show in $SPC_COUNT alone."""
    save_backup(FanucCabinet(joints_deg=[10.0, 20.0, -30.0, 40.0, 50.0, 60.0]), tmp_path)
    variables = tmp_path / "sysmast.va"
    head, name, rest = variables.read_bytes().partition(b"SPC_COUNT")
    rest = re.sub(rb"\[2\] = (-?\d+)", lambda found: b"[2] = %d" % (int(found[1]) + counts), rest, count=1)
    variables.write_bytes(head + name + rest)
    if without:
        (tmp_path / without).unlink()
    files = read_controller_files(FolderSource(tmp_path))
    if not reason:
        assert make_records(files, serial="F1").records
        return
    with pytest.raises(ControllerRecordError, match=reason):
        make_records(files, serial="F1")
