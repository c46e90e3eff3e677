"""Every procedure ends in a verdict and a certificate; what was not used and not verified stands in it."""

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.geometry import Pose
from cellcal.procedures.accuracy_limits import FrameLimits
from cellcal.procedures.arm.arm_bench import Method
from cellcal.procedures.catalogue import CATALOGUE, DEFINITIONS
from cellcal.procedures.cell import DeviceCertificate
from cellcal.procedures.forecast import Knowledge
from cellcal.procedures.recovery.recovery_spec import MasteringRecoverySpec
from cellcal.procedures.recovery.recovery_verdict import saving_texts, verdict_on_recovery
from cellcal.service.certificates.certificate import (
    NO_TRACEABILITY,
    SAFETY,
    CertificateError,
    content_of,
    issue_certificate,
)
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.configuration.instrument_tables import InstrumentCertificate
from cellcal.service.record.journal_end import missing_end
from cellcal.service.record.journal_files import journal_path, open_journal
from cellcal.service.record.run_outcome import RunOutcome, RunVerdict
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.signing import CheckFinding, check_document
from cellcal.service.runs.journal_ledger import forget_from
from cellcal.service.runs.open_cell import offline_cell
from cellcal.service.runs.run_procedure import resume_procedure
from cellcal.service.site.cell_state import DueDates
from tests.procedures.certified_runs import HOW, cell_config, run_in
from tests.procedures.procedure_scenes import (
    TARGETS,
    ProcedureScene,
    drift_scene,
    hook_scene,
    recording_scene,
    recovery_scene,
    scene_for,
    tool_touch_scene,
    user_frame_scene,
)
from tests.procedures.test_record_by_places import without_wire
from tests.service.printed_documents import verify_paper

NAMES = [entry.name for entry in DEFINITIONS]
TROUBLED = ("mastering_record", "mastering_recovery")  # certified below, with a wire that kinked once
GAUGE_CERTIFICATE = """
[gauge.certificate]
number = "C-77"
laboratory = "Lab"
issued = 2000-01-01
due = 2100-01-01
expanded_uncertainty_mm = 0.05
"""


def certificate_content(config: CellConfig, run_id: str = "last") -> dict[str, Any]:
    with open_journal(config) as journal:
        return content_of(config, journal, RunStore(journal).resolve_run_id(run_id))


@pytest.mark.parametrize("name", [name for name in NAMES if name not in TROUBLED])
async def test_every_procedure_ends_in_a_certificate_that_verifies(name: str, tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    verify_certificate(config, await run_in(config, await scene_for(name), name))


def verify_certificate(config: CellConfig, outcome: RunOutcome) -> None:
    """Issue a run's certificate and see that it is whole, signed, and says what the run found."""
    assert outcome.verdict is RunVerdict.PASSED
    issued = issue_certificate(config, outcome.run_id)
    raw = issued.json_path.read_bytes()
    checked = check_document(raw, expected_key=issued.key.public_key)
    assert checked.finding is CheckFinding.INTACT
    content = checked.content
    assert content["verdict"]["word"] == outcome.judgement["word"] == issued.word
    assert content["verdict"]["characteristics"]
    assert content["verdict"]["not_verified"]
    assert all(figure["rule"] for figure in content["verdict"]["characteristics"] if figure["decision"])
    assert content["result"] == result_of(config, outcome.run_id)
    assert {"run_id", "made_with", "journal_head_sha256"} <= content["run"].keys()
    assert content["run"]["made_with"][0]["definition_sha256"]
    text = issued.text_path.read_text()
    assert max(map(len, text.splitlines())) <= 80
    assert {"PASS": "pass", "FAIL": "fail", "UNDECIDED - measure more": "undecided"}[
        text.split("Verdict\n-------\n")[1].splitlines()[0]
    ] == issued.word
    assert SAFETY.split(".")[0] in " ".join(text.split())
    assert checked.sha256 in text
    verify_paper(issued.json_path)


def result_of(config: CellConfig, run_id: str) -> Any:
    with open_journal(config) as journal:
        return RunStore(journal).find_run(run_id).result


async def test_the_same_run_gives_the_same_bytes_and_a_spoilt_copy_is_put_right(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    issued = issue_certificate(config, outcome.run_id)
    raw = issued.json_path.read_bytes()
    assert issue_certificate(config, "last", tmp_path / "other").json_path.read_bytes() == raw
    issued.json_path.write_bytes(raw.replace(b'"pass"', b'"fail"'))
    issued.json_path.write_bytes(raw[:-2])
    assert issue_certificate(config, outcome.run_id).json_path.read_bytes() == raw


async def test_a_lost_key_leaves_earlier_certificates_as_they_are(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    first = issue_certificate(config, outcome.run_id)
    raw = first.json_path.read_bytes()
    first.key.path.unlink()
    again = issue_certificate(config, outcome.run_id)
    assert again.key.created
    assert again.json_path.read_bytes() == raw
    assert first.key.public_key in again.text_path.read_text()
    elsewhere = issue_certificate(config, outcome.run_id, tmp_path / "other").json_path.read_bytes()
    assert check_document(elsewhere, expected_key=again.key.public_key).finding is CheckFinding.INTACT


async def test_a_capture_that_was_measured_again_is_listed_with_the_reason(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), recording_scene()
    made.wire.kink_m = {2 * 7: 0.02, 2 * 7 + 1: 0.02}  # both samples of the eighth capture
    verify_certificate(config, await run_in(config, made, "mastering_record"))
    points = {point["step"]: point for point in certificate_content(config)["points"]}
    assert not points["capture 8"]["used"]
    assert "contradicted" in points["capture 8"]["reason"]
    assert points["capture again 1"]["used"]
    assert points["capture 7"]["used"]
    assert points["capture 7"]["value"]["raw"]
    assert "capture 8: contradicted" in issue_certificate(config, "last").text_path.read_text()


async def test_a_recovery_names_what_it_set_aside_and_what_must_be_signed(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), await recovery_scene()
    made.wire.kink_m = {8: 0.02, 9: 0.02}  # the fifth capture
    outcome = await run_in(config, made, "mastering_recovery")
    verify_certificate(config, outcome)
    content = certificate_content(config)
    unused = [point["step"] for point in content["points"] if not point["used"]]
    assert unused == list(outcome.result.set_aside) == ["capture 5"]
    assert any("safety" in line.lower() for line in content["verdict"]["to_sign"])
    text = issue_certificate(config, "last").text_path.read_text()
    assert "Signature ____" in text
    assert "this is no calibration" in text
    taken, checked = outcome.result.captures, outcome.result.check_captures
    assert taken + checked < 38  # 30 and 8 are what the settings allow
    (saved,) = [words for words in content["verdict"]["remarks"] if "saved" in words]
    drawn, slow = outcome.result.drawn, outcome.result.jog_speed_rad_s
    took, longer = (travel / slow / 60.0 for travel in (drawn.travel_rad, drawn.drawn_travel_rad))
    assert saved.startswith(
        f"{taken} captures, {took:.1f} minutes of moving, and {checked} checks; a fixed plan"
    )
    assert f"needs {drawn.drawn_captures} captures and {longer:.1f} minutes" in saved
    assert 0.0 < took < longer
    (none,) = saving_texts(MasteringRecoverySpec(evidence="places"), outcome.result)
    assert none.startswith("no saving: every place")
    worse = replace(outcome.result, drawn=replace(drawn, drawn_travel_rad=drawn.travel_rad))
    assert saving_texts(made.spec, worse)[0].startswith("no saving: evenly drawn poses need")
    never = replace(outcome.result, drawn=replace(drawn, drawn_captures=None))
    assert saving_texts(made.spec, never)[0].endswith("do not tell the motors as surely at all")
    before = {change["name"]: change["before"] for change in content["verdict"]["changes"]}
    assert before["J1: counts at zero"] == made.arm.true_zero[0] - 0  # as it was mastered
    large = [point for point in content["points"] if "value_sha256" in point]
    assert [point["step"] for point in large] == ["read the stored record"]
    joints = list(outcome.result.joints)
    joints[2] = replace(joints[2], exact=False, offset_u_rad=np.deg2rad(0.03))
    exchanged = replace(outcome.result, joints=tuple(joints))
    for chosen, word in (("A", "undecided"), ("B", "undecided"), ("C", "pass")):
        verdict = verdict_on_recovery(chosen, None, exchanged)  # type: ignore[arg-type]
        assert verdict.overall_decision == word
        (figure,) = [figure for figure in verdict.characteristics if figure.name == "J3: new zero"]
        assert figure.expanded_uncertainty == pytest.approx(np.deg2rad(0.03))


async def test_what_a_redo_discarded_stays_in_the_certificate(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), user_frame_scene()
    made.technician.refuses = {"accept_frame"}
    outcome = await run_in(config, made, "three_point_frame")
    made.technician.refuses = set()
    with open_journal(config) as journal:
        forget_from(journal, outcome.run_id, "touch a point on x", actor="bert")
        cell = replace(made.cell, config_sha256=config.sha256)
        assert (await resume_procedure(cell, outcome.run_id, journal, how=HOW)).verdict is RunVerdict.PASSED
    content = certificate_content(config)
    steps = [(point["step"], point["used"]) for point in content["points"]]
    assert steps == [
        ("read the user frame", True),
        ("touch the origin", True),
        ("touch a point on x", False),
        ("touch a point on the y side", False),
        ("touch a point above", False),
        ("touch a point on x", True),
        ("touch a point on the y side", True),
        ("touch a point above", True),
    ]
    assert "discarded by bert" in content["points"][2]["reason"]
    assert content["people"][0]["who"] == "anna"


async def test_touches_that_scatter_leave_it_undecided(tmp_path: Path) -> None:
    made = tool_touch_scene(max_touches=3)
    scatter_touches(made, 0.0003)
    outcome = await run_in(cell_config(tmp_path), made, "six_point_tcp")
    assert outcome.verdict is RunVerdict.PASSED
    assert outcome.judgement["word"] == "undecided"
    tip = outcome.judgement["characteristics"][0]
    # three degrees of freedom: Student's factor at most, all directions at once
    assert 2.8 < tip["coverage"] < 3.18
    assert tip["expanded_uncertainty"] > tip["limit"] == 0.0004


def scatter_touches(made: ProcedureScene, by_m: float) -> None:
    """Let the technician miss the pin by a little, each time elsewhere."""
    for k, key in enumerate(("touch", "touch_about_x", "touch_about_y")):

        def touch_beside(teach: Any = made.technician.does[key], k: int = k) -> None:
            teach()
            taught = made.arm.taught
            assert taught is not None
            place = np.array(taught.position_m) + by_m * np.array([np.cos(2 * k), np.sin(2 * k), (-1) ** k])
            made.arm.taught = Pose(tuple(float(v) for v in place), taught.quaternion)  # type: ignore[arg-type]

        made.technician.does[key] = touch_beside


async def test_limits_of_an_engineer_replace_the_class(tmp_path: Path) -> None:
    for own, word in (
        (None, "undecided"),
        (FrameLimits(0.01, 0.1), "pass"),
        (FrameLimits(1e-5, 1e-5), "undecided"),
    ):
        made = user_frame_scene()
        made.spec = replace(made.spec, limits=own)
        outcome = await run_in(cell_config(tmp_path / f"{word}{own is None}"), made, "three_point_frame")
        assert outcome.judgement["word"] == word
        assert ("engineer" in outcome.judgement["limits_from"]) == (own is not None)


async def test_traceability_only_with_a_certificate_that_is_valid_on_the_day(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    await run_in(config, hook_scene(TARGETS[:1]), "end_effector_points")
    today = datetime.now(UTC).date()
    for from_days, to_days, claims in ((-10, 10, True), (-10, -1, False), (2, 10, False)):
        issued, due = (today + timedelta(days=days) for days in (from_days, to_days))
        instrument_certificate = InstrumentCertificate(
            number="C-77",
            laboratory="Lab",
            accreditation="D-K-1",
            issued=issued,
            due=due,
            expanded_uncertainty_mm=0.05,
        )
        (entry,) = config.gauges
        setup = entry.setup.model_copy(update={"certificate": instrument_certificate})
        with_it = replace(config, gauges=(replace(entry, setup=setup),))
        traceability = certificate_content(with_it)["traceability"]
        assert (NO_TRACEABILITY not in traceability) == claims
        assert ("of Lab, D-K-1" in traceability) == claims
        edited = replace(with_it, text=config.text + "\n# edited")
        assert NO_TRACEABILITY in certificate_content(edited)["traceability"]
    assert certificate_content(config)["traceability"] == NO_TRACEABILITY


@pytest.mark.parametrize(("due", "word"), [("2001-02-03", "undecided"), ("2999-12-31", "pass")])
async def test_a_gauge_whose_calibration_has_lapsed_gives_no_pass(
    tmp_path: Path, due: str, word: str
) -> None:
    made = hook_scene(TARGETS[:1])
    made.cell = replace(made.cell, certificates={"gauge": DeviceCertificate("C-77", "2000-02-03", due)})
    outcome = await run_in(cell_config(tmp_path), made, "end_effector_points")
    figures_by_name = {figure["name"]: figure for figure in outcome.judgement["characteristics"]}
    assert outcome.judgement["word"] == word
    assert ("the gauge's calibration is valid" in figures_by_name) == (word == "undecided")


TRACKER = """
[[tracker]]
name = "at"
driver = "laser_tracker"
address = "127.0.0.1"
serial = 390793
station = 1
robot = "fanuc"
target_in_flange_mm = [80.0, 40.0, 100.0]
[tracker.certificate]
number = "T-12"
laboratory = "Other lab"
issued = 2000-01-01
due = {due}
expanded_uncertainty_mm = 0.02
"""
PROBE_AND_DIAL = """
[[probe]]
name = "{name}"
driver = "{driver}"
address = "127.0.0.1"
serial = "00:30:DE:0A:0B:0C"
robot = "fanuc"
tip_in_flange_mm = [0.0, 0.0, 160.0]
sigma_mm = 0.003
{more}
[probe.certificate]
number = "{name}-1"
laboratory = "Lab"
issued = 2000-01-01
due = 2050-06-07
expanded_uncertainty_mm = 0.004
"""
LAPSED, HOLDS = "2001-02-03", "2999-12-31"


@pytest.mark.parametrize(
    ("method", "gauge_due", "tracker_due", "word"),
    [
        ("tracker", LAPSED, HOLDS, "pass"),  # the wire was there and was not read
        ("tracker", HOLDS, LAPSED, "undecided"),
        ("wire", HOLDS, LAPSED, "pass"),
        ("wire", LAPSED, HOLDS, "undecided"),
    ],
)
async def test_the_instrument_that_was_read_decides_and_not_one_that_is_there(
    tmp_path: Path, method: Method, gauge_due: str, tracker_due: str, word: str
) -> None:
    config = cell_config(
        tmp_path, more=GAUGE_CERTIFICATE.replace("2100-01-01", gauge_due) + TRACKER.format(due=tracker_due)
    )
    made = await drift_scene(method)
    instrument_certificates = {
        role: DeviceCertificate(role, "2000-01-01", due)
        for role, due in (("gauge", gauge_due), ("tracker", tracker_due))
    }
    made.cell = replace(made.cell, certificates=instrument_certificates)
    outcome = await run_in(config, made, "drift_check")
    assert outcome.judgement["word"] == word
    traceability = certificate_content(config)["traceability"]
    name = "gauge" if method == "wire" else "tracker"
    if word == "pass":
        expected_line = (
            "Lengths refer to certificate C-77 of Lab"
            if method == "wire"
            else "Places seen by the tracker refer to certificate T-12 of Other lab"
        )
        assert traceability.startswith(expected_line)
        assert traceability.endswith("Nothing else is claimed to be traceable.")
    else:
        assert f"the {name}'s calibration is valid" in {
            figure["name"] for figure in outcome.judgement["characteristics"]
        }
        assert traceability.startswith(NO_TRACEABILITY)
        assert f"The {name}'s certificate" in traceability
    verify_certificate(config, outcome)


async def test_a_probe_whose_calibration_has_lapsed_gives_no_pass(tmp_path: Path) -> None:
    words = {}
    for due in (LAPSED, HOLDS):
        made = without_wire(probe=True)
        made.cell = replace(made.cell, certificates={"probe": DeviceCertificate("P-1", "2000-01-01", due)})
        outcome = await run_in(cell_config(tmp_path / due), made, "mastering_record")
        words[due] = outcome.judgement["word"]
        named = {figure["name"] for figure in outcome.judgement["characteristics"]}
        assert ("the touch probe's calibration is valid" in named) == (due == LAPSED)
    assert words == {LAPSED: "undecided", HOLDS: "pass"}


async def test_a_reading_that_a_redo_discarded_is_behind_nothing(tmp_path: Path) -> None:
    """What counts is folded from the journal: which instruments a finding rests on, and whether it still counts."""
    config = cell_config(tmp_path)
    outcome = await run_in(config, await drift_scene("tracker"), "drift_check")
    with open_journal(config) as journal:
        past = RunStore(journal).find_run(outcome.run_id).past
        assert past.instrument_roles == ("tracker",)
        read = [finding.step for finding in past.findings if finding.instruments]
        assert read
        assert all(step.startswith("capture") for step in read)
        forget_from(journal, outcome.run_id, read[0])
        assert RunStore(journal).find_run(outcome.run_id).past.instrument_roles == ()


def test_every_instrument_of_a_cell_becomes_due(tmp_path: Path) -> None:
    probes = "".join(
        PROBE_AND_DIAL.format(name=name, driver=driver, more=more)
        for name, driver, more in (
            (
                "probe",
                "touch_probe",
                "contact_input = 1\ntip_radius_mm = 1.5\novertravel_mm = 3.0\n"
                "delay_ms = 6.0\ndelay_tolerance_ms = 3.0",
            ),
            ("dial", "dial_gauge", "dial_input = 1\nrange_mm = 12.5"),
        )
    )
    config = cell_config(tmp_path, more=GAUGE_CERTIFICATE + TRACKER.format(due=HOLDS) + probes)
    due = {due_item["what"]: due_item["due"] for due_item in DueDates(config).due_items(0.0)}
    assert due["calibration of wire"] == "2100-01-01"
    assert due["calibration of at"] == HOLDS
    assert due["calibration of probe"] == due["calibration of dial"] == "2050-06-07"
    assert offline_cell(config).certificates.keys() == {"gauge", "tracker", "probe", "dial"}


async def test_a_run_without_the_gauge_claims_nothing_of_its_certificate(tmp_path: Path) -> None:
    config = cell_config(tmp_path, more=GAUGE_CERTIFICATE)
    assert config.gauges[0].setup.certificate is not None
    await run_in(config, user_frame_scene(), "three_point_frame")
    assert certificate_content(config)["traceability"] == NO_TRACEABILITY


async def test_what_did_not_end_with_a_result_is_not_certified(tmp_path: Path) -> None:
    config, made = cell_config(tmp_path), user_frame_scene()
    made.technician.refuses = {"accept_frame"}
    outcome = await run_in(config, made, "three_point_frame")
    with pytest.raises(CertificateError, match="no result to certify"):
        issue_certificate(config, outcome.run_id)
    assert not (config.cell.data_dir / "signing_key.pem").exists()


async def test_nothing_is_certified_from_a_damaged_journal(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    with open_journal(config) as journal:
        journal._database.execute("UPDATE event SET actor = 'mallory' WHERE seq = 3").fetchall()
    with pytest.raises(CertificateError, match="damaged") as error_info:
        issue_certificate(config, outcome.run_id)
    assert error_info.value.code == "store.damaged"


async def test_a_verdict_that_cannot_be_given_does_not_lose_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail_verdict(*_: object) -> None:
        raise ZeroDivisionError

    entry = CATALOGUE["three_point_frame"]
    monkeypatch.setitem(CATALOGUE, "three_point_frame", replace(entry, verdict=fail_verdict))
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    assert (outcome.verdict, outcome.judgement) == (RunVerdict.PASSED, None)
    assert "could not be given" in caplog.text
    issued = issue_certificate(config, outcome.run_id)
    assert issued.word == "undecided"
    assert "states no verdict" in issued.text_path.read_text()


@pytest.mark.parametrize("name", NAMES)
async def test_every_procedure_foretells_finite_figures_without_a_device(name: str) -> None:
    made, entry = await scene_for(name), CATALOGUE[name]
    assert entry.forecast is not None
    cell = made.cell
    assert cell.gauge is not None
    assert cell.tracker is not None
    knowledge = Knowledge(
        cell.model,
        cell.gauge_setup,
        cell.gauge.capabilities,
        cell.record,
        cell.position_record,
        limits=cell.limits,
        tracker_setup=cell.tracker_setup,
        tracker=cell.tracker.capabilities,
        alignments=cell.alignments,
        drift_references=cell.drift_references,
    )
    forecast = entry.forecast(made.spec, knowledge)
    assert np.isfinite(forecast.duration_s)
    assert forecast.duration_s > 0
    assert forecast.predictions or forecast.assumed
    for prediction in forecast.predictions:
        assert np.isfinite(prediction.expanded)
        assert prediction.expanded >= 0
    json.dumps([pose.joints_rad for pose in forecast.poses], allow_nan=False)


async def test_a_journal_that_lost_its_end_is_betrayed_by_a_certificate(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, tool_touch_scene(), "six_point_tcp")
    issue_certificate(config, outcome.run_id)
    with open_journal(config) as journal:
        assert missing_end(config, journal) == ""
        last = journal.list_events()[-1].seq
    with closing(sqlite3.connect(journal_path(config))) as database, database:
        database.execute("DELETE FROM event WHERE seq = ?", (last,))
    with open_journal(config) as journal:
        assert journal.damage is None
        assert f"{outcome.run_id}.json was issued after an event" in missing_end(config, journal)
    (tmp_path / "data/certificates" / f"{outcome.run_id}.json").write_bytes(b"\x00{")
    with open_journal(config) as journal:
        assert missing_end(config, journal) == ""
