"""Reviews, comparisons and rollback over the service's routes: they are the run's own figures, and alter nothing."""

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
from tests.service.cell_with_history import (
    ROBOT,
    SERIAL,
    SLIPPED_STEP,
    SPOILT_STEP,
    PastRuns,
    cell_with_past_runs,
)
from tests.service.service_client import (
    ServiceClient,
    ServiceClock,
    another_browser,
    cheap_hasher,
    with_people,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def past_runs(tmp_path_factory: pytest.TempPathFactory) -> PastRuns:
    path = write_cell_file(tmp_path_factory.mktemp("past"), "127.0.0.1", seed=1, time_factor=500.0)
    return await cell_with_past_runs(path)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(past_runs: PastRuns) -> AsyncIterator[httpx.AsyncClient]:
    """The service over that cell's journal, without its cell process and without sign-in."""
    app = create_app(ServiceSettings(past_runs.config.path, open_access=True))
    async with another_browser(app) as browser:
        yield browser
    if hasattr(app.state, "solver"):
        await app.state.solver.stop_worker()


@asynccontextmanager
async def open_service_client(config: CellConfig) -> AsyncIterator[ServiceClient]:
    """The same service with people who have rights."""
    app, clock = create_app(ServiceSettings(config.path)), ServiceClock()
    authenticator = Authenticator(
        config.cell.data_dir, open_access=False, clock=clock, wall_clock=clock, make_hasher=cheap_hasher
    )
    if not authenticator.accounts.list_people():
        with_people(authenticator)
    app.state.context = replace(app.state.context, authenticator=authenticator)
    async with another_browser(app) as browser:
        yield ServiceClient(app, browser, clock)


async def get_json(client: httpx.AsyncClient, path: str) -> Any:
    answer = await client.get(path)
    assert answer.status_code == 200, answer.text
    return answer.json()


async def what_if(client: httpx.AsyncClient, run_id: str, used: list[str]) -> httpx.Response:
    return await client.post(f"/api/runs/{run_id}/what-if", json={"used": used})


def used_steps(review: dict[str, Any]) -> list[str]:
    return [point["step"] for point in review["points"]]


def view_of(past: PastRuns, run_id: str) -> RunView:
    with open_journal(past.config) as journal:
        return RunStore(journal).find_run(run_id)


def captured_values(findings: tuple[Finding, ...], kind: str) -> np.ndarray:
    return np.array([f.value["joints_rad"] for f in findings if f.step.startswith(kind)])


async def test_a_review_shows_the_signed_figures(past_runs: PastRuns, client: httpx.AsyncClient) -> None:
    review = await get_json(client, f"/api/runs/{past_runs.calibration}/review")
    identified = view_of(past_runs, past_runs.calibration).result["identified"]
    assert review["signed"]
    assert identified["captures"] == 16
    assert len(review["points"]) == 16 + sum(identified["tool"]["captures"])
    assert review["rms_m"] == pytest.approx(np.sqrt(3.0) * identified["residual_rms_m"], rel=1e-9)
    assert review["u_m"] == review["signed_u_m"] == pytest.approx(identified["tip_u_m"], rel=1e-9)
    out = HoldOutErrors(**identified["hold_out"])
    for which, rms_m, max_m in (
        ("before", out.before_rms_m, out.before_max_m),
        ("after", out.after_rms_m, out.after_max_m),
    ):
        spread = review["validation"][which]
        assert spread["rms_m"] == pytest.approx(np.sqrt(3.0) * rms_m, rel=1e-9)
        assert spread["max_m"] == pytest.approx(max_m, rel=1e-9)
        assert spread["mean_m"] <= spread["rms_m"] <= spread["max_m"]
        assert 0 < spread["u_m"] < spread["rms_m"]
    assert len(review["validation"]["points"]) == out.captures


async def test_check_poses_are_none_of_the_fitted_ones(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    review = await get_json(client, f"/api/runs/{past_runs.calibration}/review")
    fitted, checked = set(used_steps(review)), {point["step"] for point in review["validation"]["points"]}
    assert fitted
    assert checked
    assert not fitted & checked
    findings = view_of(past_runs, past_runs.calibration).past.findings
    checks = captured_values(findings, "capture check ")
    taken = np.array([f.value["joints_rad"] for f in findings if f.step in fitted])
    assert len(checks) == len(checked)
    assert np.abs(checks[:, None] - taken[None]).max(axis=2).min() > 0.02


async def test_what_the_run_did_not_believe_is_an_outlier_and_can_be_put_back(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    review = await get_json(client, f"/api/runs/{past_runs.spoilt}/review")
    assert [p["step"] for p in review["points"] if not p["used"]] == [SPOILT_STEP]
    assert [p["step"] for p in review["points"] if p["outlier"]] == [SPOILT_STEP]
    spoilt = next(p for p in review["points"] if p["outlier"])
    assert spoilt["residual_m"] == pytest.approx(0.005, rel=0.05)  # 4 and 3 mm were added
    put_back = (await what_if(client, past_runs.spoilt, used_steps(review))).json()
    assert not put_back["signed"]
    assert put_back["u_m"] > 2.0 * review["u_m"]
    assert put_back["validation"]["after"]["rms_m"] > 2.0 * review["validation"]["after"]["rms_m"]
    assert put_back["signed_u_m"] == review["u_m"]
    assert next(p for p in put_back["points"] if p["step"] == SPOILT_STEP)["outlier"]


async def test_a_reading_less_is_known_a_little_worse_and_changes_nothing_signed(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    before = (await client.get(f"/api/runs/{past_runs.calibration}/certificate.json")).content
    with open_journal(past_runs.config) as journal:
        head = journal.head_hash()
    review = await get_json(client, f"/api/runs/{past_runs.calibration}/review")
    less = (await what_if(client, past_runs.calibration, used_steps(review)[1:])).json()
    assert [p["step"] for p in less["points"] if not p["used"]] == used_steps(review)[:1]
    assert less["u_m"] > review["u_m"] == less["signed_u_m"]
    again = (await what_if(client, past_runs.calibration, used_steps(review))).json()
    assert again == review
    assert (await client.get(f"/api/runs/{past_runs.calibration}/certificate.json")).content == before
    with open_journal(past_runs.config) as journal:
        assert journal.head_hash() == head


async def test_touches_are_reviewed_like_readings(past_runs: PastRuns, client: httpx.AsyncClient) -> None:
    review = await get_json(client, f"/api/runs/{past_runs.touches}/review")
    tip = view_of(past_runs, past_runs.touches).result["tip"]
    assert review["along"] == "touch"
    assert review["u_m"] == pytest.approx(tip["tip_u_in_space_m"])
    sizes = np.linalg.norm(np.array(tip["residuals_m"]), axis=1)
    assert sorted(p["residual_m"] for p in review["points"]) == pytest.approx(sorted(sizes))
    fewer = await what_if(client, past_runs.touches, used_steps(review)[:2])
    assert fewer.status_code == 422
    assert fewer.json()["code"] == "review.too_few"
    assert review["validation"] is None  # no touch was kept back


async def test_points_of_any_fit_can_be_left_out_and_nothing_is_kept(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    at = f"/api/runs/{past_runs.moved}/certificate.json"
    signed = (await client.get(at)).content
    with open_journal(past_runs.config) as journal:
        head = journal.head_hash()
    review = await get_json(client, f"/api/runs/{past_runs.moved}/review")
    assert (review["along"], review["u_of"], review["signed"]) == ("place", "origin", True)
    found = view_of(past_runs, past_runs.moved).result["found"]
    origin = [value["value"] for value in review["values"][:3]]
    assert origin == pytest.approx(found["base_frame_new"]["position_m"], abs=1e-12)
    assert review["u_m"] == pytest.approx(2.0 * np.sqrt(np.linalg.eigvalsh(_origin_of(found))[-1]))
    rest = [step for step in used_steps(review) if step != SLIPPED_STEP]
    less = (await what_if(client, past_runs.moved, rest)).json()
    assert not less["signed"]
    assert less["rms_m"] < 0.1 * review["rms_m"] == 0.1 * less["signed_rms_m"]
    assert [value["signed"] for value in less["values"]] == [value["value"] for value in review["values"]]
    assert max(abs(value["value"] - value["signed"]) for value in less["values"][:3]) > 1e-5
    assert next(p for p in less["points"] if not p["used"])["residual_m"] > 5e-4
    assert (await what_if(client, past_runs.moved, used_steps(review))).json() == review
    fewer = await what_if(client, past_runs.moved, rest[:2])
    assert (fewer.status_code, fewer.json()["code"]) == (422, "review.too_few")
    assert (await client.get(at)).content == signed
    with open_journal(past_runs.config) as journal:
        assert journal.head_hash() == head


def _origin_of(found: Any) -> np.ndarray:
    return np.array(found["placed"]["covariance"])[:3, :3]


async def test_three_points_are_shown_and_none_can_be_spared(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    review = await get_json(client, f"/api/runs/{past_runs.frame}/review")
    assert used_steps(review) == ["touch the origin", "touch a point on x", "touch a point on the y side"]
    refused = await what_if(client, past_runs.frame, used_steps(review)[:2])
    assert (refused.status_code, refused.json()["code"]) == (422, "review.too_few")
    assert refused.json()["message"] == "2 points are too few for this fit."


async def test_the_map_shows_the_hidden_error_of_the_arm(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    review = await get_json(client, f"/api/runs/{past_runs.calibration}/review")
    errors = np.array([place["error_m"] for place in review["places"]])
    uncertainties_m = np.array([place["u_m"] for place in review["places"]])
    assert len(errors) == 12
    assert errors.max() == pytest.approx(review["validation"]["before"]["max_m"], rel=0.5)
    assert np.sqrt((uncertainties_m**2).mean()) == pytest.approx(review["u_m"], rel=1e-6)


@pytest.mark.parametrize(
    ("used", "code"), [(["capture 99"], "review"), ([], "review.too_few"), (["capture 1"], "review.too_few")]
)
async def test_a_what_if_of_nothing_says_why(
    past_runs: PastRuns, client: httpx.AsyncClient, used: list[str], code: str
) -> None:
    answer = await what_if(client, past_runs.calibration, used)
    assert answer.status_code == 422
    assert answer.json()["code"] == code
    assert answer.json()["remedy"]


async def test_the_solver_survives_what_breaks_a_question(past_runs: PastRuns) -> None:
    solver = ComputeClient(past_runs.config.path)
    try:
        with pytest.raises(ComputeError, match="failed"):
            await solver.ask_worker("review", no_such_argument=1)
        with pytest.raises(ComputeError):
            await solver.ask_worker("review", run_id="x")
        both = [solver.ask_worker("review", run_id=run) for run in (past_runs.calibration, past_runs.touches)]
        assert [each["run_id"] for each in await asyncio.gather(*both)] == [
            past_runs.calibration,
            past_runs.touches,
        ]
    finally:
        await solver.stop_worker()


async def test_an_accuracy_check_shows_before_and_after(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    run_id = next(
        r["run_id"] for r in await get_json(client, "/api/runs") if r["procedure"] == "accuracy_check"
    )
    review = await get_json(client, f"/api/runs/{run_id}/review")
    assert review["points"] == []
    result = view_of(past_runs, run_id).result
    if result["identified"] is None:
        assert review["validation"] is None
    else:
        assert review["validation"]["after"]["max_m"] == max(p["ap_m"] for p in result["identified"]["poses"])


async def test_frames_and_the_doubt_about_the_tool_come_from_runs(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    frames = {
        (f["kind"], f["name"], f["fixed_in"]) for f in await get_json(client, f"/api/models/{ROBOT}/frames")
    }
    assert frames == {("tool", "3", "flange"), ("user", "2", "base")}
    assert await get_json(client, "/api/models/ur/frames") == []
    at = f"/api/models/{ROBOT}/uncertainty?joints_rad="
    uncertainty = await get_json(client, at + "0.1,0.1,0.1,0.1,0.1,0.1")
    assert uncertainty["parts"] == ["tool", "arm"]
    assert uncertainty["semi_axes_m"] == sorted(uncertainty["semi_axes_m"], reverse=True)
    tip = view_of(past_runs, past_runs.touches).result["tip"]
    of_tool = 2.0 * np.sqrt(np.linalg.eigvalsh(tip["tip_covariance_m2"])[::-1])
    assert (np.array(uncertainty["semi_axes_m"]) > of_tool).all()
    axes = np.array(uncertainty["base_ellipsoid"]).reshape(3, 3)
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.linalg.det(axes) == pytest.approx(1.0)
    nothing = await get_json(client, "/api/models/ur/uncertainty?joints_rad=0,0,0,0,0,0")
    assert (nothing["parts"], nothing["semi_axes_m"]) == ([], [])
    for wrong in ("0,0", "a,b,c,d,e,f", "nan,0,0,0,0,0"):
        assert (await client.get(at + wrong)).status_code == 422


async def test_two_runs_are_compared_figure_by_figure(past_runs: PastRuns, client: httpx.AsyncClient) -> None:
    comparison = await get_json(client, f"/api/runs/{past_runs.spoilt}/against/{past_runs.calibration}")
    assert (comparison["before"]["run_id"], comparison["after"]["run_id"]) == (
        past_runs.calibration,
        past_runs.spoilt,
    )
    assert comparison["settings"] == []
    figures = {figure["name"]: figure for figure in comparison["figures"]}
    zero = figures["J2 offset, true minus shown"]
    old, new = (
        next(c for c in view_of(past_runs, run).judgement["characteristics"] if c["name"] == zero["name"])
        for run in (past_runs.calibration, past_runs.spoilt)
    )
    assert zero["difference"] == pytest.approx(new["value"] - old["value"])
    expected = 2.0 * np.hypot(old["standard_uncertainty"], new["standard_uncertainty"])
    assert zero["expanded_uncertainty"] == pytest.approx(expected)
    assert zero["changed"] == (abs(zero["difference"]) > expected)
    others = await get_json(client, f"/api/runs/{past_runs.frame}/against/{past_runs.calibration}")
    assert all(figure["difference"] is None for figure in others["figures"])
    assert {setting["name"] for setting in others["settings"]} >= {"method", "frame_number"}


async def test_a_certificate_is_checked_as_it_lies_on_the_disk(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    at = f"/api/runs/{past_runs.frame}/certificate"
    signed = (await client.get(f"{at}.json")).content
    check_answer = await get_json(client, f"{at}/check")
    assert (check_answer["finding"], check_answer["by_this_cell"], check_answer["word"]) == (
        "intact",
        True,
        "undecided",
    )
    assert check_answer["sha256"] in signed.decode()
    path = past_runs.config.cell.data_dir / "certificates" / f"{past_runs.frame}.json"
    path.write_bytes(signed.replace(b'"undecided"', b'"pass"', 1))
    check_answer = await get_json(client, f"{at}/check")
    assert (check_answer["finding"], check_answer["word"]) == ("tampered", "")
    assert (await client.get(f"{at}.json")).content == signed  # written anew from the journal
    assert (await get_json(client, f"{at}/check"))["finding"] == "intact"


async def test_a_diff_is_stated_in_millimetres_of_the_tip(
    past_runs: PastRuns, client: httpx.AsyncClient
) -> None:
    at = f"/api/parameters/{SERIAL}/displacement"
    difference = await get_json(client, f"{at}?before=1&after=2")
    assert 0.0 < difference["mean_m"] < difference["most_m"]
    one, two = (
        view_of(past_runs, run).result["identified"]["offsets"]
        for run in (past_runs.calibration, past_runs.spoilt)
    )
    turned = sum(abs(b["value_rad"] - a["value_rad"]) for a, b in zip(one, two, strict=True))
    assert difference["most_m"] < 2.5 * turned  # no lever of this arm is longer
    assert (await get_json(client, f"{at}?before=1&after=1"))["most_m"] == 0.0
    assert (await client.get(f"{at}?before=1&after=99")).status_code == 422


async def test_going_back_takes_what_a_write_takes(past_runs: PastRuns) -> None:
    sets = ParameterSets(past_runs.config.path.parent / FOLDER)
    files = {path: path.read_bytes() for path in (past_runs.config.path.parent / FOLDER).rglob("*.toml")}
    newest = sets.load_set(SERIAL).version
    back = {"id": "a", "to": 1, "newest": newest, "note": "the tool was bent"}
    at = f"/api/parameters/{SERIAL}/rollback"
    async with open_service_client(past_runs.config) as service_client:
        await service_client.from_console()
        for name in ("Vera", "Ada"):
            await service_client.sign_in(name)
            assert (await service_client.post_json(at, back)).json()["code"] == "people.role", name
        await service_client.sign_in("Tom")
        assert (await service_client.post_json(at, back)).json()["code"] == "people.second_person"
        assert (await service_client.post_json(at, back)).json()[
            "code"
        ] == "people.second_person"  # again the same person
        assert sets.load_set(SERIAL).version == newest
        await service_client.sign_in("Tina")
        service_client.clock.pass_by(150.0)
        assert (await service_client.post_json(at, back)).json()["code"] == "people.pin"
        await service_client.post_json("/api/sign-in/confirm", {"secret": "141421"})
        saved = await service_client.post_json(at, back)
        assert saved.status_code == 200, saved.text
        assert (
            await service_client.post_json(at, back)
        ).json() == saved.json()  # a lost answer: nothing is saved twice
    parameter_set = sets.load_set(SERIAL)
    assert (parameter_set.version, parameter_set.rolls_back_to, parameter_set.made_by) == (
        newest + 1,
        1,
        "Tom and Tina",
    )
    assert parameter_set.note == "the tool was bent"
    assert parameter_set.values == sets.load_set(SERIAL, 1).values
    assert {path: path.read_bytes() for path in files} == files


async def test_going_back_is_refused_where_it_means_another_version(past_runs: PastRuns) -> None:
    sets = ParameterSets(past_runs.config.path.parent / FOLDER)
    newest = sets.load_set(SERIAL).version
    at = f"/api/parameters/{SERIAL}/rollback"
    async with open_service_client(past_runs.config) as service_client:
        await service_client.from_console()
        await service_client.sign_in("Emil")
        for change, status, code in (
            ({"to": 1, "newest": newest + 1}, 409, "parameters.newer"),
            ({"to": newest, "newest": newest}, 422, "usage"),
            ({"to": 0, "newest": newest}, 422, "request"),
        ):
            answer = await service_client.post_json(at, {"id": str(change), **change})
            assert (answer.status_code, answer.json()["code"]) == (status, code)
        assert (
            await service_client.post_json("/api/parameters/none/rollback", {"id": "x", "to": 1, "newest": 2})
        ).status_code == 422
        assert sets.load_set(SERIAL).version == newest
        assert (await service_client.post_json(at, {"id": "e", "to": 1, "newest": newest})).status_code == 200
    assert sets.load_set(SERIAL).made_by == "Emil"
