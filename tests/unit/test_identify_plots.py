"""Pictures of an identification: they show the numbers they claim to show, and the same ones every time."""

from dataclasses import replace

import numpy as np
import pytest

from cellcal.service.engineering.identification.identify import identify_file
from cellcal.service.engineering.identification.row_fit import IdentifyOptions
from cellcal.service.engineering.plots.correlations import strong_pairs
from cellcal.service.engineering.plots.evidence import IdentificationEvidence, places_of, thin_rows
from cellcal.service.engineering.plots.identify_plots import draw_identification
from cellcal.service.engineering.plots.residuals import draw_by_joint, held_out_by_row
from cellcal.service.engineering.plots.style import new_figure, write_figures
from cellcal.service.engineering.plots.workspace import error_map
from tests.unit.helpers.simulated_arm import tracker_points, wire_lengths

NAMES = {"overview", "residuals_by_row", "residuals_by_joint", "workspace", "correlations", "distribution"}
WILD_ROW, WILD_M = 40, 0.02


def file_of(simulated, path):
    observations = simulated.observations
    wire = observations.kind == "length"
    values = observations.lengths_m[:, None] if wire else observations.positions_m
    names = [*(f"q{i}" for i in range(1, 7)), *(["L"] if wire else ["x", "y", "z"])]
    table = np.concatenate([np.rad2deg(observations.joints_rad), values * 1e3], axis=1)
    lines = [",".join(names), *(",".join(f"{v:.7f}" for v in row) for row in table)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def plot_evidence(tmp_path_factory):
    """A UR10 seen by a tracker, with one wild row: off upwards, as seen from the base."""
    simulated = tracker_points("ur10", 120)
    path = tmp_path_factory.mktemp("plots") / "points.csv"
    clean = identify_file(file_of(simulated, path), "ur10", IdentifyOptions(level=2, train_rows=119))
    up = clean.identification.state.devices[0].device_base[:3, 2]
    simulated.observations.positions_m[WILD_ROW] += WILD_M * up
    return IdentificationEvidence(
        identify_file(file_of(simulated, path), "ur10", IdentifyOptions(level=2, train_rows=119))
    )


def test_every_figure_is_written_as_png_and_svg(tmp_path):
    report = identify_file(file_of(wire_lengths("ur10", 14), tmp_path / "wire.csv"), "ur10")
    written = draw_identification(report, tmp_path / "new" / "folder")
    assert {path.name for path in written} == {f"{name}.{kind}" for name in NAMES for kind in ("png", "svg")}
    assert all(path.stat().st_size > 5000 for path in written)


def test_the_same_report_draws_the_same_files(plot_evidence, tmp_path):
    twice = []
    for name in ("a", "b"):
        figure = new_figure(8, 6)
        error_map(figure, plot_evidence)
        twice.append([path.read_bytes() for path in write_figures({"map": figure}, tmp_path / name)])
    assert twice[0] == twice[1]


def test_residuals_have_sign_and_direction(plot_evidence):
    (at,) = np.flatnonzero(plot_evidence.fitted_rows == WILD_ROW)
    after = {name: pair[1][at] for name, pair in plot_evidence.signed_mm.items()}
    assert after["upwards"] == pytest.approx(WILD_M * 1e3, abs=0.5)
    assert abs(after["outwards"]) < 0.5
    assert abs(after["sideways"]) < 0.5


def test_rejected_rows_and_breaks_are_marked_where_they_are(plot_evidence):
    report = replace(
        plot_evidence.report, held_out_rows=plot_evidence.fitted_rows, held_out_m=np.ones(119), before_m=np.ones(119),
        breaks=(33,),
    )  # fmt: skip
    panel = new_figure(4, 3).subplots()
    held_out_by_row(panel, IdentificationEvidence(report))
    drawn = {line.get_label(): np.asarray(line.get_xdata()) for line in panel.lines}
    assert WILD_ROW in drawn["rejected by the fit"]
    assert set(drawn["rejected by the fit"]) == {item.row for item in report.rejected}
    assert set(drawn["device moved"]) == {32.5}


def test_predicted_uncertainty_is_that_of_the_covariance(plot_evidence):
    fit = plot_evidence.report.identification.robust.fit
    joints = np.array([[0.3, -1.1, 1.4, -0.8, 0.9, 0.4], [-2.0, -0.4, 0.7, 1.0, -1.1, 2.0]])

    def axis_sigma(change):
        state = fit.layout.apply_step(fit.state, change)
        return state.seen_from(0).base_flange(joints)[:, :3, 3]

    step = 1e-6
    columns = [
        (axis_sigma(step * one) - axis_sigma(-step * one)) / (2 * step) for one in np.eye(len(fit.layout))
    ]
    variance = np.einsum("pnc,pq,qnc->n", columns, fit.covariance, columns)
    assert plot_evidence.sigma_m(joints) == pytest.approx(np.sqrt(variance), rel=1e-5)


def test_places_are_those_of_the_target_in_the_base_frame(plot_evidence):
    device_base = plot_evidence.identified_state.devices[0].device_base
    measured = plot_evidence.fitted_observations.positions_m[:20]
    in_base = (measured - device_base[:3, 3]) @ device_base[:3, :3]
    assert (
        np.abs(
            places_of(plot_evidence.identified_state, plot_evidence.fitted_observations.joints_rad[:20])
            - in_base
        ).max()
        < 1e-3
    )


def test_each_joint_has_its_panel_in_each_direction(plot_evidence):
    figure = new_figure(6, 4)
    draw_by_joint(figure, plot_evidence)
    assert len(figure.axes) == 18
    assert [panel.get_xlabel() for panel in figure.axes[12:]] == [f"J{i} (deg)" for i in range(1, 7)]
    assert [figure.axes[6 * k].get_ylabel() for k in range(3)] == [
        "outwards (mm)", "sideways (mm)", "upwards (mm)",
    ]  # fmt: skip


def test_of_very_many_rows_the_worst_are_drawn():
    errors = np.zeros(100_000)
    errors[[7, 99_001]] = 1.0
    shown = thin_rows(errors)
    assert {7, 99_001} <= set(shown.tolist())
    assert len(shown) < 25_000


def test_strong_pairs_are_found_once_strongest_first():
    rho = np.eye(4)
    rho[0, 3] = rho[3, 0] = -0.99
    rho[1, 2] = rho[2, 1] = 0.96
    rho[0, 1] = rho[1, 0] = 0.94
    assert strong_pairs(rho) == [(0, 3), (1, 2)]
