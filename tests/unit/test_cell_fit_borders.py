"""What a cell refuses, and what it says to do."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.calibration.cells.cell import (
    CalibrationCell,
    CellDevice,
    CellRobot,
    CellSeries,
    CellTarget,
    CellTool,
    DeviceScalar,
)
from cellcal.calibration.cells.contact_observations import BarLengths, PlaneContacts
from cellcal.calibration.cells.frame_priors import FramePrior
from cellcal.calibration.cells.identify import fit_cell
from cellcal.calibration.cells.levels import CellOptions
from cellcal.calibration.cells.prediction import frame_between, tip_covariance
from cellcal.calibration.errors import CalibrationError, DegenerateDataError
from cellcal.calibration.geometry import homogeneous_matrix
from cellcal.calibration.identification.parameters import GEOMETRY, OFFSETS, nominal_state
from tests.unit.helpers.simulated_cell import REFLECTORS, TRACKER, SimulatedWorld

WORLD = SimulatedWorld(seed=1)
POINTS = WORLD.point_rows(20)
BARE = CellOptions(level=OFFSETS, judge=False)


def cell_with_changes(**changes):
    parts = {
        "robots": [CellRobot("arm", WORLD.model)],
        "tools": [CellTool("tip", "arm")],
        "devices": [CellDevice("tracker")],
        "series": [CellSeries("rows", "tracker", "tip", POINTS)],
    }
    return CalibrationCell(**{**parts, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tools": [CellTool("tip", "arm 2")]}, "there is no robot 'arm 2'"),
        ({"targets": [CellTarget("smr", "probe", FramePrior.from_point(REFLECTORS[1]))]}, "no tool 'probe'"),
        ({"series": [CellSeries("rows", "tracer", "tip", POINTS)]}, "no device 'tracer'"),
        ({"series": [CellSeries("rows", "tracker", "tap", POINTS)]}, "no target 'tap'"),
        ({"series": []}, "needs a robot and a series"),
        ({"devices": [CellDevice("tracker"), CellDevice("tracker")]}, "name of its own"),
        (
            {"devices": [CellDevice("tracker", scalars={"zeros": DeviceScalar(0.0, 1.0)})]},
            "no number 'zeros'",
        ),
        (
            {
                "series": [
                    CellSeries("r", "tracker", "tip", replace(POINTS, mounting=np.ones(20, dtype=np.intp)))
                ]
            },
            "rows of mounting 2",
        ),
    ],
)
def test_names_and_shapes_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(CalibrationError, match=message):
        cell_with_changes(**changes)


def test_joints_of_another_robot_are_refused():
    few = replace(POINTS, joints_rad=POINTS.joints_rad[:, :5])
    with pytest.raises(CalibrationError, match="has 6 joints, its rows have 5"):
        cell_with_changes(series=[CellSeries("rows", "tracker", "tip", few)])


@pytest.mark.parametrize(
    "observations",
    [
        replace(POINTS, sigma_m=np.zeros(20)),
        replace(POINTS, sigma_m=np.full(20, np.nan)),
        replace(POINTS, sigma_m=np.ones(19)),
        replace(POINTS, mounting=np.full(20, -1)),
        POINTS.select_rows(np.arange(0)),
    ],
)
def test_rows_without_a_usable_deviation_are_refused(observations):
    with pytest.raises(CalibrationError, match="series 'rows'"):
        CellSeries("rows", "tracker", "tip", observations)


def test_rows_that_are_not_numbers_are_refused():
    joints, once = POINTS.joints_rad, np.zeros(20, dtype=np.intp)
    with pytest.raises(CalibrationError, match="finite"):
        PlaneContacts(joints, np.full(20, np.inf), np.ones(20), once)
    with pytest.raises(CalibrationError, match="second postures"):
        BarLengths(joints, np.ones(20), np.ones(20), once, joints[:5])
    with pytest.raises(CalibrationError, match="above zero"):
        CellSeries("bar", "bar", "tip", BarLengths(joints, -np.ones(20), np.ones(20), once, joints))


@pytest.mark.parametrize(
    "covariance",
    [
        np.tile(np.eye(3), (19, 1, 1)),
        np.tile(np.diag([1.0, 1.0, -1.0]), (20, 1, 1)),
        np.full((20, 3, 3), np.nan),
    ],
)
def test_covariances_must_be_positive_and_one_a_row(covariance):
    with pytest.raises(CalibrationError, match="covariance"):
        CellSeries("rows", "tracker", "tip", POINTS, covariance)


def test_places_are_rigid_and_their_deviations_not_negative():
    with pytest.raises(CalibrationError, match="rigid"):
        FramePrior.from_pose(np.diag([2.0, 1.0, 1.0, 1.0]))
    with pytest.raises(CalibrationError, match="deviations"):
        FramePrior(np.eye(4), np.full(6, -1.0))
    with pytest.raises(CalibrationError, match="needs its pose"):
        FramePrior(None, np.full(6, 1e-3))
    with pytest.raises(CalibrationError, match="three finite numbers"):
        FramePrior.from_point((1.0, np.nan, 0.0))


def test_a_robot_that_nothing_ties_to_the_world_is_refused():
    other = SimulatedWorld("abb_irb120", seed=2)
    robots = [CellRobot("arm", WORLD.model), CellRobot("mate", other.model)]
    tools = [CellTool("tip", "arm"), CellTool("probe", "mate")]
    series = [
        CellSeries("rows", "tracker", "tip", POINTS),
        CellSeries("others", "second tracker", "probe", other.point_rows(20)),
    ]
    devices = [CellDevice("tracker"), CellDevice("second tracker")]
    loose = CalibrationCell(robots, tools, devices, series)
    with pytest.raises(CalibrationError, match="where robot 'mate' stands"):
        fit_cell(loose, BARE)
    tied = replace(loose, robots=[robots[0], replace(robots[1], base=FramePrior.from_pose(np.eye(4)))])
    assert fit_cell(tied, BARE).level == OFFSETS


def test_touches_of_a_plane_alone_ask_for_a_rough_tool_and_do_with_it():
    plane = homogeneous_matrix(np.eye(3), np.array([0.4, 0.1, 0.1]))
    touched = cell_with_changes(
        devices=[CellDevice("table")], series=[CellSeries("t", "table", "tip", WORLD.at_plane(plane, 40))]
    )
    with pytest.raises(DegenerateDataError, match="'tool'") as caught:
        fit_cell(touched, BARE)
    assert "within 50 mm" in caught.value.remedy
    rough = replace(
        touched, tools=[CellTool("tip", "arm", FramePrior.point_without_prior((0.03, -0.03, 0.1)))]
    )
    found = fit_cell(rough, CellOptions(level=GEOMETRY, judge=False))
    assert found.robust.series[0].scale[0] == pytest.approx(1.0, abs=0.4)
    assert {"J1 offset", "J6 offset"} <= {item.parameter for item in found.not_identified}


def test_bars_alone_ask_for_a_rough_tool():
    with pytest.raises(DegenerateDataError, match="'tool'"):
        fit_cell(
            cell_with_changes(series=[CellSeries("b", "tracker", "tip", WORLD.bar_rows(count=30))]), BARE
        )


def test_too_few_rows_are_refused_with_what_to_do():
    few = cell_with_changes(series=[CellSeries("rows", "tracker", "tip", WORLD.point_rows(3))])
    with pytest.raises(DegenerateDataError, match="9 readings cannot tell 9 unknown") as caught:
        fit_cell(few, BARE)
    assert "Measure more" in caught.value.remedy


def test_options_that_name_nothing_are_refused():
    with pytest.raises(CalibrationError, match="no level 9"):
        fit_cell(cell_with_changes(), replace(BARE, level=9))
    with pytest.raises(CalibrationError, match="no parameter 'J9 offset'"):
        fit_cell(cell_with_changes(), replace(BARE, free=("J9 offset",)))
    found = fit_cell(cell_with_changes(), CellOptions(level=OFFSETS, judge=False, fixed=("J2", "J3 offset")))
    assert [p.name for p in found.robust.fit.layout.parameters if p.role == "offset"] == [
        f"J{i} offset" for i in (1, 4, 5, 6)
    ]


def test_questions_about_what_the_cell_does_not_have_are_refused():
    fit = fit_cell(cell_with_changes(), BARE).robust.fit
    with pytest.raises(CalibrationError, match="no target 'tap'"):
        tip_covariance(fit, "tap", POINTS.joints_rad)
    with pytest.raises(CalibrationError, match="no robot and no device 'camera'"):
        frame_between(fit, "arm", "camera")
    with pytest.raises(CalibrationError, match="joints must be finite"):
        tip_covariance(fit, "tip", np.full((2, 6), np.nan))


def test_earlier_parameters_of_another_model_are_refused():
    other = SimulatedWorld("abb_irb120").model
    strange = CellRobot("arm", replace(WORLD.model, dh=None), previous=nominal_state(other, ()))
    with pytest.raises(CalibrationError, match="another model"):
        fit_cell(cell_with_changes(robots=[strange]), BARE)


def test_a_series_of_few_rows_keeps_its_stated_deviations():
    nest = CellDevice("nest", (FramePrior.from_pose(TRACKER),))
    short = CellSeries("nest", "nest", "tip", WORLD.point_rows(1))
    found = fit_cell(
        cell_with_changes(
            devices=[CellDevice("tracker"), nest],
            series=[CellSeries("rows", "tracker", "tip", POINTS), short],
        ),
        BARE,
    )
    assert not found.robust.series[1].scale_found
    assert found.robust.series[1].scale[0] >= 1.0
    assert found.robust.series[0].scale_found
