"""One file of a FANUC backup, damaged in one place; and whether a record of it would be wrong."""

import random
from pathlib import Path

import numpy as np

from cellcal.calibration.errors import CellError
from cellcal.drivers.fanuc.controller_files.controller_files import read_controller_files
from cellcal.drivers.fanuc.controller_files.file_sources import FolderSource
from cellcal.fake_devices.fanuc_files.cabinet import FanucCabinet
from cellcal.service.engineering.controller_files.record_from_files import make_records
from tests.wire.fanuc_ftp import save_backup

NAMES = (
    "axis.dg",
    "curpos.dg",
    "sysmast.va",
    "symotn.va",
    "erract.ls",
    "version.dg",
    "sysframe.va",
    "main.ls",
)
WRONG_DEG = 0.021  # two hundredths that the controller shows


def damage_bytes(data: bytes, rng: random.Random) -> bytes:
    """Flip, cut, repeat, drop or insert something."""
    at, other = sorted(rng.randrange(len(data)) for _ in range(2))
    lines = data.split(b"\n")
    line = rng.randrange(len(lines))
    choices = (
        data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :],
        data[:at] + rng.choice((b"9", b"-", b".", b"*", b"\0", b" ", b"e9", b"nan")) + data[at:],
        data[:at],
        data[:at] + data[other:],
        b"\n".join([*lines[:line], *lines[line + 1 :]]),
        b"\n".join([*lines[: line + 1], *lines[line:]]),
        data[:at] + data[at:other] * 2 + data[other:],
    )
    return rng.choice(choices)


def judge_damage(folder: Path, seed: int) -> str:
    """Damage one file of a backup and read it; return "refused", "harmless" or what is wrong."""
    rng = random.Random(seed)
    cabinet = FanucCabinet(joints_deg=[rng.uniform(-80.0, 80.0) for _ in range(6)])
    save_backup(cabinet, folder)
    path = folder / rng.choice(NAMES)
    path.write_bytes(damage_bytes(path.read_bytes(), rng))
    try:
        (done,) = make_records(read_controller_files(FolderSource(folder)), serial="F1").records
    except CellError:
        return "refused"
    except Exception as error:
        return f"seed {seed}, {path.name}: {type(error).__name__}: {error}"
    missed = np.abs(np.degrees([row.angle_rad for row in done.rows]) - cabinet.joints_deg)
    if len(done.rows) != 6 or not missed.max() <= WRONG_DEG:
        return f"seed {seed}, {path.name}: accepted with angles wrong by {missed} deg"
    return "harmless"
