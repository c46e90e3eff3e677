"""Rows of another station or robot in a file are named with what they are, and not counted as chance outliers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellcal.calibration.identification.identify import identify_arm, start_identification
from cellcal.calibration.identification.observations import PointObservations
from cellcal.calibration.identification.parameters import GEOMETRY
from cellcal.calibration.identification.rows_apart import rows_apart
from cellcal.calibration.identification.selection import IdentificationOptions
from cellcal.calibration.identification.work_parts import SERIAL
from cellcal.service.engineering.identification import row_fit
from cellcal.service.engineering.identification.identify_check import prepare_measurements
from cellcal.service.engineering.identification.identify_start import StartOptions, read_start
from cellcal.service.engineering.measured.measurements import ReadOptions
from tests.unit.helpers.simulated_arm import tracker_points

_OPTIONS = IdentificationOptions(level=GEOMETRY, judge=False)


def _joined(first: PointObservations, second: PointObservations, first_row: int) -> PointObservations:
    return replace(
        first,
        joints_rad=np.concatenate([first.joints_rad[:first_row], second.joints_rad]),
        positions_m=np.concatenate([first.positions_m[:first_row], second.positions_m]),
    )


@pytest.mark.parametrize(
    ("robot", "expected"), [("abb_irb120", "by themselves:"), ("ur5e", "by themselves either")]
)
def test_a_block_of_rows_from_elsewhere_is_named(robot: str, expected: str) -> None:
    here, there = tracker_points("abb_irb120", 52, seed=1), tracker_points(robot, 12, seed=5).observations
    moved = replace(there, positions_m=there.positions_m[:, [1, 0, 2]] * [-1.0, 1.0, 1.0] + 1.0)
    found = identify_arm(here.model, _joined(here.observations, moved, 40), options=_OPTIONS)
    notes = rows_apart(found, np.arange(100, 152))
    assert [note.code for note in notes] == ["apart"]
    assert "140 to 151" in notes[0].message
    assert expected in notes[0].message
    assert notes[0].rows == tuple(range(140, 152))


def test_a_few_outliers_are_no_other_station() -> None:
    here = tracker_points("abb_irb120", 52, seed=1)
    positions_m = here.observations.positions_m.copy()
    positions_m[[3, 17, 30]] += 0.05
    found = identify_arm(here.model, replace(here.observations, positions_m=positions_m), options=_OPTIONS)
    assert list(found.rejected) == [3, 17, 30]
    assert rows_apart(found, np.arange(52)) == []


def test_rows_of_another_station_take_no_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = (tracker_points("abb_irb120", count, seed=1) for count in (52, 64))
    of_both = here.observations, there.observations.select_rows(np.arange(52, 64))
    positions = [of_both[0].positions_m, of_both[1].positions_m[:, [1, 0, 2]] * [-1.0, 1.0, 1.0] + 1.0]
    joints = [points.joints_rad for points in of_both]
    order = np.random.default_rng(0).permutation(64)
    rows = np.column_stack([np.rad2deg(np.concatenate(joints)), 1e3 * np.concatenate(positions)])[order]
    path = tmp_path / "rows.csv"
    np.savetxt(path, rows, "%.5f", ",", header="J1,J2,J3,J4,J5,J6,X,Y,Z", comments="")

    def begin_quickly(*args, options, **named):
        options = replace(options, judge=False, find_breaks=False)
        return start_identification(*args, options=options, **named)

    monkeypatch.setattr(row_fit, "start_identification", begin_quickly)
    monkeypatch.setattr(row_fit, "refuse_misfit", lambda *_: None)
    monkeypatch.setattr(row_fit, "_refuse_changes", lambda *_: None)
    prepared = prepare_measurements(path, here.model, ReadOptions())
    start = read_start(StartOptions(), here.model, "point")
    fitted = row_fit.fit_rows(here.model, prepared, start, row_fit.IdentifyOptions(level=1), SERIAL)
    assert fitted.split[0].tolist() == np.flatnonzero(order < 52).tolist()
    assert fitted.elsewhere is not None
    assert fitted.elsewhere.rows.tolist() == np.flatnonzero(order > 51).tolist()
    assert "abb_irb120 by themselves:" in fitted.elsewhere.describe_in_file(here.model, np.arange(64)).message
