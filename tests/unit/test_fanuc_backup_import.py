"""``cellcal mastering import BACKUP``: what a controller's files tell becomes the record, and nothing is invented."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.drivers.programs.errors import ProgramFileError
from cellcal.procedures.recovery.record_seal import seal_of
from cellcal.procedures.run import RefusalError
from cellcal.procedures.steps.mastering import stored_record
from cellcal.service.cli.mastering import mastering
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.engineering.parameters.fanuc_backup import edits_to, import_backup
from cellcal.service.engineering.parameters.mastering_files import (
    RecordFileError,
    export_record,
    import_record,
    in_force,
)
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore
from tests.procedures.certified_runs import cell_config
from tests.procedures.procedure_scenes import healthy_scene, record_of
from tests.unit.helpers.fanuc_va import VariablesController


@dataclass(frozen=True)
class RobotOptions:
    robot: str | None = "fanuc"
    group: int = 1


@pytest.fixture
def fake_controller() -> VariablesController:
    return VariablesController(
        ratios=(99.5, 121.0, 119.2, 80.4, 76.1, 51.3), reference_rad=[0.1, -0.2, 0.3, 0.4, 0.5, 0.6]
    )


def test_a_backup_becomes_the_record_in_force(fake_controller, tmp_path: Path) -> None:
    config = cell_config(tmp_path / "cell")
    done = import_backup(
        config, fake_controller.save_variables(tmp_path / "backup"), who="anna", of=RobotOptions()
    )
    record = in_force(config).record
    assert done.record == record
    assert not done.was_known
    assert record.counts_at_zero == tuple(fake_controller.counts)
    assert record.reference_counts == tuple(fake_controller.counts_at(fake_controller.reference_rad))
    links = fake_controller.reference_rad  # as the controller stores them: J2 the other way, J3 + J2
    assert record.reference_joints_rad == pytest.approx(
        [links[0], -links[1], links[2] + links[1], *links[3:]], abs=1e-6
    )
    matrix = fake_controller.coupling_matrix()
    shown = np.array([matrix[0], -matrix[1], matrix[2] + matrix[1], *matrix[3:]])
    assert np.allclose(record.drive.radians_per_count, shown, rtol=1e-6)
    assert (record.wire, record.prior, record.captures, record.kit) == (None, None, (), None)
    assert record.sha256 == seal_of(record)
    assert "wire lengths" in done.not_in_backup[0]
    assert import_backup(config, tmp_path / "backup", who="anna", of=RobotOptions()).was_known


def test_its_sheet_and_its_way_to_another_computer(fake_controller, tmp_path: Path) -> None:
    config = cell_config(tmp_path / "cell")
    fake_controller.reference_rad = None
    done = import_backup(
        config, fake_controller.save_variables(tmp_path / "backup"), who="anna", of=RobotOptions()
    )
    assert "reference pose" in done.not_in_backup[-1]
    signed, sheet = export_record(config, None, tmp_path / "stick")
    text = sheet.read_text()
    for expected_text in (
        "nothing measured",
        "not told",
        "cannot be found with it",
        str(fake_controller.counts[5]),
    ):
        assert expected_text in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80
    other = cell_config(tmp_path / "other")
    assert import_record(other, signed, who="bert").record == done.record


async def test_a_record_of_counts_only_finds_no_turns_and_replaces_no_better_one(
    fake_controller, tmp_path: Path
) -> None:
    made = healthy_scene()
    config, record = cell_config(tmp_path / "cell"), await record_of(made)
    backup = fake_controller.save_variables(tmp_path / "backup")
    done = import_backup(config, backup, who="anna", of=RobotOptions())
    with pytest.raises(RefusalError, match="no lengths or places"):
        await stored_record(replace(made.cell, record=done.record))
    with open_journal(config) as journal:
        RunStore(journal).put_mastering_record(record, actor="anna")
    with pytest.raises(RecordFileError, match="Only the one in force can find lost turns"):
        import_backup(config, backup, who="anna", of=RobotOptions())
    assert in_force(config).record == record


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mastered": False}, "MASTER_DONE is FALSE"),
        ({"states": [2, 2, 0, 2, 2, 2]}, "axis 3 was lost"),
        ({"ratios": (99.5, 121.0, 119.2)}, "has 6 axes, group 1 of the backup 3"),
    ],
)
def test_a_mastering_that_is_not_valid_is_refused(
    fake_controller, tmp_path: Path, change, words: str
) -> None:
    config = cell_config(tmp_path / "cell")
    for name, value in change.items():
        setattr(fake_controller, name, value)
    if "ratios" in change:
        fake_controller.counts, fake_controller.states = fake_controller.counts[:3], [2] * 3
        fake_controller.reference_rad = None
    with pytest.raises(RecordFileError, match=words):
        import_backup(
            config, fake_controller.save_variables(tmp_path / "backup"), who="anna", of=RobotOptions()
        )
    with pytest.raises(RecordFileError, match="no mastering record"):
        in_force(config)


@pytest.mark.parametrize(
    ("serial", "reported", "outcome"),
    [
        ("F-270477", "F270477", "named"),
        ("f270477", "F270477", "named"),
        ("F-104711", "F270477", "refused"),
        ("R16Y01234", "F270477", "unnamed"),  # the arm's own number: nothing to compare
        ("F-104711", "", "unnamed"),
    ],
)
def test_the_version_report_says_whose_backup_it_is(
    fake_controller, tmp_path: Path, serial: str, reported: str, outcome: str
) -> None:
    config = cell_config(tmp_path / "cell", serial=serial)
    backup = fake_controller.save_variables(tmp_path / "backup")
    (backup / "version.dg").write_text(f"VERSION INFORMATION::\nRobot No.           : {reported}\n")
    if outcome == "refused":
        with pytest.raises(RecordFileError, match="is of robot F270477, and the cell file says F-104711"):
            import_backup(config, backup, who="anna", of=RobotOptions())
        with pytest.raises(RecordFileError, match="no mastering record"):
            in_force(config)
        return
    done = import_backup(config, backup, who="anna", of=RobotOptions())
    assert any("whose robot" in each for each in done.not_in_backup) == (outcome == "unnamed")


def test_files_that_are_missing_or_damaged(fake_controller, tmp_path: Path) -> None:
    config = cell_config(tmp_path / "cell")
    backup = fake_controller.save_variables(tmp_path / "backup")
    with pytest.raises(RecordFileError, match="does not say whose it is"):
        import_backup(config, backup, who="anna", of=RobotOptions(robot=None))
    with pytest.raises(RecordFileError, match="group 2 has no axes"):
        import_backup(config, backup, who="anna", of=RobotOptions(group=2))
    data = (backup / "SYMOTN.VA").read_bytes()
    (backup / "SYMOTN.VA").write_bytes(data[:-900])
    with pytest.raises(ProgramFileError, match=r"SYMOTN\.VA:\d+"):
        import_backup(config, backup, who="anna", of=RobotOptions())
    (backup / "SYMOTN.VA").unlink()
    with pytest.raises(RecordFileError, match=r"SYMOTN\.VA is not in"):
        import_backup(config, backup, who="anna", of=RobotOptions())


def test_the_edits_back_to_the_controller(fake_controller, tmp_path: Path) -> None:
    config = cell_config(tmp_path / "cell")
    with pytest.raises(RecordFileError, match="no mastering record"):
        edits_to(config, fake_controller.save_variables(tmp_path / "backup"), RobotOptions())
    import_backup(config, tmp_path / "backup", who="anna", of=RobotOptions())
    assert edits_to(config, tmp_path / "backup", RobotOptions()) == ()
    fake_controller.counts[2] += 3 * 2**19
    fake_controller.save_variables(tmp_path / "now")
    lines = edits_to(config, tmp_path / "now", RobotOptions())
    assert "$DMR_GRP[1].$MASTER_COUN[3] from 17778281 to 16205417" in lines[0]
    assert "$MASTER_DONE" in lines[1]


def test_the_commands(fake_controller, tmp_path: Path, capsys) -> None:
    cell = str(cell_config(tmp_path / "cell").path)
    backup = str(fake_controller.save_variables(tmp_path / "backup"))
    of = ("--cell", cell, "--robot", "fanuc")
    assert run_command("import", backup, *of, "--group", "1", "--json") == 0
    output = json.loads(capsys.readouterr().out)
    assert output["counts_at_zero"] == fake_controller.counts
    assert len(output["not_in_backup"]) == 3
    assert run_command("show", *of) == 0
    assert "nothing measured" in capsys.readouterr().out
    assert run_command("edits", backup, *of) == 0
    assert "Nothing" in capsys.readouterr().out
    fake_controller.mastered = False
    fake_controller.save_variables(tmp_path / "backup")
    with pytest.raises(RecordFileError, match="MASTER_DONE is FALSE"):
        run_command("import", backup, *of, "--replace")
    assert in_force(read_cell_file(Path(cell))).record.counts_at_zero == tuple(fake_controller.counts)


def run_command(*words: str) -> int:
    return mastering(words, exit_on_error=False, result_action="return_value")
