"""Reviews, comparisons and rollback at the service's door: they are the run's own figures, and alter nothing."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest
import pytest_asyncio

from cellcal.procedures.arm.calibration_result import HoldOutErrors
from cellcal.procedures.run_history import Finding
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.people.authentication import Authenticator
from cellcal.service.record.journal_files import open_journal
from cellcal.service.record.run_store import RunStore, RunView
from cellcal.service.review.compute_client import ComputeClient, ComputeError
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.doors import Clock, Door, another_browser, quick, with_people
from tests.service.reviewed import ROBOT, SERIAL, SLIPPED_STEP, SPOILT_STEP, Past, with_a_past

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.xdist_group("reviews")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def past(tmp_path_factory: pytest.TempPathFactory) -> Past:
    path = write_cell_file(tmp_path_factory.mktemp("past"), "127.0.0.1", seed=1, time_factor=500.0)
    return await with_a_past(path)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(past: Past) -> AsyncIterator[httpx.AsyncClient]:
    """The service over that cell's journal, without its desk; everybody may look."""
    app = create_app(ServiceSettings(past.config.path, open_access=True))
    async with another_browser(app) as browser:
        yield browser
    if hasattr(app.state, "solver"):
        await app.state.solver.leave()


@asynccontextmanager
async def at_the_door(config: CellConfig) -> AsyncIterator[Door]:
    """The same service with people who have rights."""
    app, clock = create_app(ServiceSettings(config.path)), Clock()
    entrance = Authenticator(
        config.cell.data_dir, open_access=False, clock=clock, wall_clock=clock, make_hasher=quick
    )
    if not entrance.accounts.list_people():
        with_people(entrance)
    app.state.house = replace(app.state.house, entrance=entrance)
    async with another_browser(app) as browser:
        yield Door(app, browser, clock)


async def asked(client: httpx.AsyncClient, path: str) -> Any:
    answer = await client.get(path)
    assert answer.status_code == 200, answer.text
    return answer.json()


async def what_if(client: httpx.AsyncClient, run_id: str, used: list[str]) -> httpx.Response:
    return await client.post(f"/api/runs/{run_id}/what-if", json={"used": used})


def steps(review: dict[str, Any]) -> list[str]:
    return [point["step"] for point in review["points"]]


def view_of(past: Past, run_id: str) -> RunView:
    with open_journal(past.config) as journal:
        return RunStore(journal).find_run(run_id)


def captured(findings: tuple[Finding, ...], kind: str) -> np.ndarray:
    return np.array([f.value["joints_rad"] for f in findings if f.step.startswith(kind)])


async def test_a_review_tells_the_signed_figures(past: Past, client: httpx.AsyncClient) -> None:
    told = await asked(client, f"/api/runs/{past.calibration}/review")
    identified = view_of(past, past.calibration).result["identified"]
    assert told["signed"]
    assert identified["captures"] == 16
    assert len(told["points"]) == 16 + sum(identified["tool"]["captures"])
    assert told["rms_m"] == pytest.approx(np.sqrt(3.0) * identified["residual_rms_m"], rel=1e-9)
    assert told["u_m"] == told["signed_u_m"] == pytest.approx(identified["tip_u_m"], rel=1e-9)
    out = HoldOutErrors(**identified["hold_out"])
    for which, rms_m, max_m in (
        ("before", out.before_rms_m, out.before_max_m),
        ("after", out.after_rms_m, out.after_max_m),
    ):
        spread = told["validation"][which]
        assert spread["rms_m"] == pytest.approx(np.sqrt(3.0) * rms_m, rel=1e-9)
        assert spread["max_m"] == pytest.approx(max_m, rel=1e-9)
        assert spread["mean_m"] <= spread["rms_m"] <= spread["max_m"]
        assert 0 < spread["u_m"] < spread["rms_m"]
    assert len(told["validation"]["points"]) == out.captures


async def test_check_poses_are_none_of_the_fitted_ones(past: Past, client: httpx.AsyncClient) -> None:
    told = await asked(client, f"/api/runs/{past.calibration}/review")
    fitted, checked = set(steps(told)), {point["step"] for point in told["validation"]["points"]}
    assert fitted
    assert checked
    assert not fitted & checked
    findings = view_of(past, past.calibration).past.findings
    checks = captured(findings, "capture check ")
    taken = np.array([f.value["joints_rad"] for f in findings if f.step in fitted])
    assert len(checks) == len(checked)
    assert np.abs(checks[:, None] - taken[None]).max(axis=2).min() > 0.02


async def test_what_the_run_did_not_believe_is_an_outlier_and_can_be_put_back(
    past: Past, client: httpx.AsyncClient
) -> None:
    told = await asked(client, f"/api/runs/{past.spoilt}/review")
    assert [p["step"] for p in told["points"] if not p["used"]] == [SPOILT_STEP]
    assert [p["step"] for p in told["points"] if p["outlier"]] == [SPOILT_STEP]
    spoilt = next(p for p in told["points"] if p["outlier"])
    assert spoilt["residual_m"] == pytest.approx(0.005, rel=0.05)  # 4 and 3 mm were added
    put_back = (await what_if(client, past.spoilt, steps(told))).json()
    assert not put_back["signed"]
    assert put_back["u_m"] > 2.0 * told["u_m"]
    assert put_back["validation"]["after"]["rms_m"] > 2.0 * told["validation"]["after"]["rms_m"]
    assert put_back["signed_u_m"] == told["u_m"]
    assert next(p for p in put_back["points"] if p["step"] == SPOILT_STEP)["outlier"]


async def test_a_reading_less_is_known_a_little_worse_and_changes_nothing_signed(
    past: Past, client: httpx.AsyncClient
) -> None:
    before = (await client.get(f"/api/runs/{past.calibration}/certificate.json")).content
    with open_journal(past.config) as journal:
        head = journal.head_hash()
    told = await asked(client, f"/api/runs/{past.calibration}/review")
    less = (await what_if(client, past.calibration, steps(told)[1:])).json()
    assert [p["step"] for p in less["points"] if not p["used"]] == steps(told)[:1]
    assert less["u_m"] > told["u_m"] == less["signed_u_m"]
    again = (await what_if(client, past.calibration, steps(told))).json()
    assert again == told
    assert (await client.get(f"/api/runs/{past.calibration}/certificate.json")).content == before
    with open_journal(past.config) as journal:
        assert journal.head_hash() == head


async def test_touches_are_reviewed_like_readings(past: Past, client: httpx.AsyncClient) -> None:
    told = await asked(client, f"/api/runs/{past.touches}/review")
    tip = view_of(past, past.touches).result["tip"]
    assert told["along"] == "touch"
    assert told["u_m"] == pytest.approx(tip["tip_u_in_space_m"])
    sizes = np.linalg.norm(np.array(tip["residuals_m"]), axis=1)
    assert sorted(p["residual_m"] for p in told["points"]) == pytest.approx(sorted(sizes))
    fewer = await what_if(client, past.touches, steps(told)[:2])
    assert fewer.status_code == 422
    assert fewer.json()["code"] == "review.too_few"
    assert told["validation"] is None  # no touch was kept back


async def test_points_of_any_fit_can_be_left_out_and_nothing_is_kept(
    past: Past, client: httpx.AsyncClient
) -> None:
    at = f"/api/runs/{past.moved}/certificate.json"
    signed = (await client.get(at)).content
    with open_journal(past.config) as journal:
        head = journal.head_hash()
    told = await asked(client, f"/api/runs/{past.moved}/review")
    assert (told["along"], told["u_of"], told["signed"]) == ("place", "origin", True)
    found = view_of(past, past.moved).result["found"]
    origin = [value["value"] for value in told["values"][:3]]
    assert origin == pytest.approx(found["base_frame_new"]["position_m"], abs=1e-12)
    assert told["u_m"] == pytest.approx(2.0 * np.sqrt(np.linalg.eigvalsh(_origin_of(found))[-1]))
    rest = [step for step in steps(told) if step != SLIPPED_STEP]
    less = (await what_if(client, past.moved, rest)).json()
    assert not less["signed"]
    assert less["rms_m"] < 0.1 * told["rms_m"] == 0.1 * less["signed_rms_m"]
    assert [value["signed"] for value in less["values"]] == [value["value"] for value in told["values"]]
    assert max(abs(value["value"] - value["signed"]) for value in less["values"][:3]) > 1e-5
    assert next(p for p in less["points"] if not p["used"])["residual_m"] > 5e-4
    assert (await what_if(client, past.moved, steps(told))).json() == told
    fewer = await what_if(client, past.moved, rest[:2])
    assert (fewer.status_code, fewer.json()["code"]) == (422, "review.too_few")
    assert (await client.get(at)).content == signed
    with open_journal(past.config) as journal:
        assert journal.head_hash() == head


def _origin_of(found: Any) -> np.ndarray:
    return np.array(found["placed"]["covariance"])[:3, :3]


async def test_three_points_are_shown_and_none_can_be_spared(past: Past, client: httpx.AsyncClient) -> None:
    told = await asked(client, f"/api/runs/{past.frame}/review")
    assert steps(told) == ["touch the origin", "touch a point on x", "touch a point on the y side"]
    refused = await what_if(client, past.frame, steps(told)[:2])
    assert (refused.status_code, refused.json()["code"]) == (422, "review.too_few")
    assert refused.json()["message"] == "2 points are too few for this fit."


async def test_the_map_shows_the_hidden_error_of_the_arm(past: Past, client: httpx.AsyncClient) -> None:
    told = await asked(client, f"/api/runs/{past.calibration}/review")
    errors = np.array([place["error_m"] for place in told["places"]])
    known = np.array([place["u_m"] for place in told["places"]])
    assert len(errors) == 12
    assert errors.max() == pytest.approx(told["validation"]["before"]["max_m"], rel=0.5)
    assert np.sqrt((known**2).mean()) == pytest.approx(told["u_m"], rel=1e-6)


@pytest.mark.parametrize(
    ("used", "code"), [(["capture 99"], "review"), ([], "review.too_few"), (["capture 1"], "review.too_few")]
)
async def test_a_what_if_of_nothing_says_why(
    past: Past, client: httpx.AsyncClient, used: list[str], code: str
) -> None:
    answer = await what_if(client, past.calibration, used)
    assert answer.status_code == 422
    assert answer.json()["code"] == code
    assert answer.json()["remedy"]


async def test_the_solver_survives_what_breaks_a_question(past: Past) -> None:
    solver = ComputeClient(past.config.path)
    try:
        with pytest.raises(ComputeError, match="failed"):
            await solver.ask_worker("review", no_such_argument=1)
        with pytest.raises(ComputeError):
            await solver.ask_worker("review", run_id="x")
        both = [solver.ask_worker("review", run_id=run) for run in (past.calibration, past.touches)]
        assert [each["run_id"] for each in await asyncio.gather(*both)] == [past.calibration, past.touches]
    finally:
        await solver.stop_worker()


async def test_an_accuracy_check_is_told_before_and_after(past: Past, client: httpx.AsyncClient) -> None:
    run_id = next(r["run_id"] for r in await asked(client, "/api/runs") if r["procedure"] == "accuracy_check")
    told = await asked(client, f"/api/runs/{run_id}/review")
    assert told["points"] == []
    result = view_of(past, run_id).result
    if result["identified"] is None:
        assert told["validation"] is None
    else:
        assert told["validation"]["after"]["max_m"] == max(p["ap_m"] for p in result["identified"]["poses"])


async def test_frames_and_the_doubt_about_the_tool_come_from_runs(
    past: Past, client: httpx.AsyncClient
) -> None:
    frames = {
        (f["kind"], f["name"], f["fixed_in"]) for f in await asked(client, f"/api/models/{ROBOT}/frames")
    }
    assert frames == {("tool", "3", "flange"), ("user", "2", "base")}
    assert await asked(client, "/api/models/ur/frames") == []
    at = f"/api/models/{ROBOT}/uncertainty?joints_rad="
    told = await asked(client, at + "0.1,0.1,0.1,0.1,0.1,0.1")
    assert told["parts"] == ["tool", "arm"]
    assert told["semi_axes_m"] == sorted(told["semi_axes_m"], reverse=True)
    tip = view_of(past, past.touches).result["tip"]
    of_tool = 2.0 * np.sqrt(np.linalg.eigvalsh(tip["tip_covariance_m2"])[::-1])
    assert (np.array(told["semi_axes_m"]) > of_tool).all()
    axes = np.array(told["base_ellipsoid"]).reshape(3, 3)
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    nothing = await asked(client, "/api/models/ur/uncertainty?joints_rad=0,0,0,0,0,0")
    assert (nothing["parts"], nothing["semi_axes_m"]) == ([], [])
    for wrong in ("0,0", "a,b,c,d,e,f", "nan,0,0,0,0,0"):
        assert (await client.get(at + wrong)).status_code == 422


async def test_two_runs_are_compared_figure_by_figure(past: Past, client: httpx.AsyncClient) -> None:
    told = await asked(client, f"/api/runs/{past.spoilt}/against/{past.calibration}")
    assert (told["before"]["run_id"], told["after"]["run_id"]) == (past.calibration, past.spoilt)
    assert told["settings"] == []
    figures = {figure["name"]: figure for figure in told["figures"]}
    zero = figures["J2 offset, true minus shown"]
    old, new = (
        next(c for c in view_of(past, run).judgement["characteristics"] if c["name"] == zero["name"])
        for run in (past.calibration, past.spoilt)
    )
    assert zero["difference"] == pytest.approx(new["value"] - old["value"])
    expected = 2.0 * np.hypot(old["standard_uncertainty"], new["standard_uncertainty"])
    assert zero["expanded_uncertainty"] == pytest.approx(expected)
    assert zero["changed"] == (abs(zero["difference"]) > expected)
    others = await asked(client, f"/api/runs/{past.frame}/against/{past.calibration}")
    assert all(figure["difference"] is None for figure in others["figures"])
    assert {setting["name"] for setting in others["settings"]} >= {"method", "frame_number"}


async def test_a_certificate_is_checked_as_it_lies_on_the_disk(past: Past, client: httpx.AsyncClient) -> None:
    at = f"/api/runs/{past.frame}/certificate"
    signed = (await client.get(f"{at}.json")).content
    told = await asked(client, f"{at}/check")
    assert (told["finding"], told["by_this_cell"], told["word"]) == ("intact", True, "undecided")
    assert told["sha256"] in signed.decode()
    path = past.config.cell.data_dir / "certificates" / f"{past.frame}.json"
    path.write_bytes(signed.replace(b'"undecided"', b'"pass"', 1))
    told = await asked(client, f"{at}/check")
    assert (told["finding"], told["word"]) == ("tampered", "")
    assert (await client.get(f"{at}.json")).content == signed  # written anew from the journal
    assert (await asked(client, f"{at}/check"))["finding"] == "intact"


async def test_a_diff_is_told_in_millimetres_of_the_tip(past: Past, client: httpx.AsyncClient) -> None:
    at = f"/api/parameters/{SERIAL}/displacement"
    told = await asked(client, f"{at}?before=1&after=2")
    assert 0.0 < told["mean_m"] < told["most_m"]
    one, two = (view_of(past, run).result["identified"]["offsets"] for run in (past.calibration, past.spoilt))
    turned = sum(abs(b["value_rad"] - a["value_rad"]) for a, b in zip(one, two, strict=True))
    assert told["most_m"] < 2.5 * turned  # no lever of this arm is longer
    assert (await asked(client, f"{at}?before=1&after=1"))["most_m"] == 0.0
    assert (await client.get(f"{at}?before=1&after=99")).status_code == 422


async def test_going_back_takes_what_a_write_takes(past: Past) -> None:
    sets = ParameterSets(past.config.path.parent / FOLDER)
    files = {path: path.read_bytes() for path in (past.config.path.parent / FOLDER).rglob("*.toml")}
    newest = sets.load_set(SERIAL).version
    back = {"id": "a", "to": 1, "newest": newest, "note": "the tool was bent"}
    at = f"/api/parameters/{SERIAL}/rollback"
    async with at_the_door(past.config) as door:
        await door.from_console()
        for name in ("Vera", "Ada"):
            await door.sign_in(name)
            assert (await door.post(at, back)).json()["code"] == "people.role", name
        await door.sign_in("Tom")
        assert (await door.post(at, back)).json()["code"] == "people.second_person"
        assert (await door.post(at, back)).json()["code"] == "people.second_person"  # again the same person
        assert sets.load_set(SERIAL).version == newest
        await door.sign_in("Tina")
        door.clock.pass_by(150.0)
        assert (await door.post(at, back)).json()["code"] == "people.pin"
        await door.post("/api/sign-in/confirm", {"secret": "141421"})
        saved = await door.post(at, back)
        assert saved.status_code == 200, saved.text
        assert (await door.post(at, back)).json() == saved.json()  # a lost answer: nothing is saved twice
    held = sets.load_set(SERIAL)
    assert (held.version, held.rolls_back_to, held.made_by) == (newest + 1, 1, "Tom and Tina")
    assert held.note == "the tool was bent"
    assert held.values == sets.load_set(SERIAL, 1).values
    assert {path: path.read_bytes() for path in files} == files


async def test_going_back_is_refused_where_it_means_another_version(past: Past) -> None:
    sets = ParameterSets(past.config.path.parent / FOLDER)
    newest = sets.load_set(SERIAL).version
    at = f"/api/parameters/{SERIAL}/rollback"
    async with at_the_door(past.config) as door:
        await door.from_console()
        await door.sign_in("Emil")
        for change, status, code in (
            ({"to": 1, "newest": newest + 1}, 409, "parameters.newer"),
            ({"to": newest, "newest": newest}, 422, "usage"),
            ({"to": 0, "newest": newest}, 422, "request"),
        ):
            answer = await door.post(at, {"id": str(change), **change})
            assert (answer.status_code, answer.json()["code"]) == (status, code)
        assert (
            await door.post("/api/parameters/none/rollback", {"id": "x", "to": 1, "newest": 2})
        ).status_code == 422
        assert sets.load_set(SERIAL).version == newest
        assert (await door.post(at, {"id": "e", "to": 1, "newest": newest})).status_code == 200
    assert sets.load_set(SERIAL).made_by == "Emil"
