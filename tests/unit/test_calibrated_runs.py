"""A kept calibration is used by later runs, and becomes a version of the robot's parameter set."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic_core import to_jsonable_python

from cellcal.calibration.arm.kinematics import load_model
from cellcal.calibration.drift.reference import DriftReference
from cellcal.calibration.poses.calibrated_arm import CalibratedArm, FoundParameter
from cellcal.procedures.run_history import EventKind
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.engineering.parameters.calibrated_models import calibrated_model, covariance_of
from cellcal.service.engineering.parameters.calibrated_runs import draft_of, save_calibration
from cellcal.service.engineering.parameters.parameter_files import SetOrigin
from cellcal.service.engineering.parameters.parameter_set import ParameterSetError
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import stored_body
from cellcal.service.runs.run_preview import offline_cell_with_history

SERIAL = "F-104711"
CELL = """\
[cell]
name = "kept"
data_dir = "{folder}"

[[robot]]
name = "fanuc"
driver = "modbus_robot"
profile = "fanuc_hmi"
address = "127.0.0.1"
model = "fanuc_m6ib"
serial = "F-104711"
speed_limit_rad_s = 0.5
"""
FOUND = (
    FoundParameter("J2 offset", "rad", 0.002, 1e-4, 1e-2, "offset"),
    FoundParameter("J3 a", "m", -0.0004, 5e-5, 5e-4, "geometry"),
)
ARM = CalibratedArm(
    SERIAL, "fanuc_m6ib", (1, 2, 3, 4, 5, 6), "wire", FOUND, (0.06, 0.05, 0.12), ((0.0,) * 6,)
)
ROWS = ((0.0,) * 6,) * 4
LENGTHS = ((1.0,), (1.1,), (1.2,), (1.3,))
REFERENCE = DriftReference(SERIAL, "fanuc_m6ib", "wire", (), 0, ROWS[0], ROWS, ROWS, LENGTHS, LENGTHS, 1e-4)


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.format(folder=tmp_path), encoding="utf-8")
    return read_cell_file(path)


def _store_result(config: CellConfig, what: str, value: object, run: str = "run-1") -> None:
    body = stored_body(what, SERIAL, SERIAL, to_jsonable_python(value))
    with open_journal(config) as journal:
        journal.append(run, EventKind.STORED, body, actor="test")


def test_a_stored_calibration_is_given_to_the_next_run(config: CellConfig) -> None:
    assert offline_cell_with_history(config).calibrated is None
    _store_result(config, "parameter_set", ARM)
    _store_result(config, "drift_reference", REFERENCE, "run-2")
    cell = offline_cell_with_history(config)
    assert cell.calibrated == ARM
    assert cell.drift_references == (REFERENCE,)


def test_a_calibration_becomes_a_version_once(config: CellConfig, tmp_path: Path) -> None:
    sets = ParameterSets(tmp_path / "sets")
    with pytest.raises(ParameterSetError, match="no calibration"):
        save_calibration(config, None, sets, "anna", "2026-11-21T10:00:00+00:00")
    _store_result(config, "parameter_set", ARM)
    saved = save_calibration(config, None, sets, "anna", "2026-11-21T10:00:00+00:00")
    assert (saved.version, saved.robot_serial, saved.made_by) == (1, SERIAL, "anna")
    moved = calibrated_model(load_model("fanuc_m6ib"), sets.load_set(SERIAL))
    assert moved.left_out == ()
    assert moved.model.dh is not None
    assert moved.model.dh.to_rows()[1, 0] == pytest.approx(
        load_model("fanuc_m6ib").dh.to_rows()[1, 0] + 0.002
    )  # type: ignore[union-attr]
    with pytest.raises(ParameterSetError, match="version 1 already"):
        save_calibration(config, None, sets, "anna", "2026-11-21T11:00:00+00:00")


def test_a_stored_calibration_names_undetermined_parameters() -> None:
    unseen = replace(FOUND[0], name="J1 offset", sigma=FOUND[0].prior)
    arm = replace(ARM, parameters=(unseen, *FOUND))
    values = draft_of(arm, SetOrigin(SERIAL, "anna", "2026-11-21T08:00:00+01:00")).values
    assert [value.determined for value in values] == [False, True, True]


def test_a_stored_calibration_keeps_its_correlations(config: CellConfig, tmp_path: Path) -> None:
    sets = ParameterSets(tmp_path / "sets")
    correlated = replace(ARM, correlations=((), (-0.4,)))
    assert len({ARM.sha256, correlated.sha256, replace(ARM, correlations=((), (0.4,))).sha256}) == 3
    _store_result(config, "parameter_set", correlated)
    assert offline_cell_with_history(config).calibrated == correlated
    save_calibration(config, None, sets, "anna", "2026-11-21T10:00:00+00:00")
    covariance = covariance_of(sets.load_set(SERIAL))
    assert covariance is not None
    assert covariance == pytest.approx(np.array([[1e-8, -0.4 * 5e-9], [-0.4 * 5e-9, 2.5e-9]]))


def test_a_calibration_stored_without_correlations_keeps_its_hash_and_has_no_covariance() -> None:
    # of the record as it was kept before correlations were: such a calibration is not saved a second time
    assert ARM.sha256 == hashlib.sha256(repr(ARM).encode()).hexdigest()
    assert "correlations" not in repr(ARM)
    assert all(
        not value.correlations
        for value in draft_of(ARM, SetOrigin(SERIAL, "anna", "2026-11-21T08:00:00+01:00")).values
    )
