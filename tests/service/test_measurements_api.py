"""Robots identified by the service from files of measurements: the figures of the command line, and who may save them."""

import asyncio
import base64
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.arm.kinematics import load_model
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.engineering.identification.jobs.jobs import IdentificationJobs
from cellcal.service.engineering.identification.jobs.limits import IdentifyProcessLimits
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.people.roles import RIGHTS, Right, Role
from cellcal.service.web.middleware import MOST_BYTES
from tests.machine_speed import stretched_s
from tests.service.service_client import PINS, ROLES, ServiceClient, open_service_client
from tests.service.source_sentences import ROOT
from tests.unit.helpers.hidden_arm import NOISE_M, HiddenArm
from tests.unit.helpers.simulated_arm import tracker_points
from tests.unit.helpers.simulated_cell import REFLECTORS, SimulatedWorld
from tests.unit.test_identify_report import file_of

PATIENCE_S = stretched_s(120.0)
JOBS = "/api/measurements/jobs"
ANCHOR_M = np.array([0.9, -0.7, -0.4])
TWO_DEVICES = """
[columns]
joints = ["J1", "J2", "J3", "J4", "J5", "J6"]
group = "stop"
[units]
joints = "deg"
readings = "mm"
[[tool]]
name = "plate"
[[target]]
name = "reflector 1"
tool = "plate"
place_mm = [0.0, 0.0, 0.0]
[[target]]
name = "reflector 2"
tool = "plate"
place_mm = [100.0, 0.0, 20.0]
[[device]]
name = "wire device"
place_mm = [900.0, -700.0, -400.0]
known_to_mm = 0.2
[[reading]]
name = "tracker"
kind = "point"
device = "tracker device"
target = "reflector 1"
columns = ["x", "y", "z"]
sigma_mm = 0.05
[[reading]]
name = "wire"
kind = "length"
device = "wire device"
target = "reflector 2"
columns = ["wire"]
sigma_mm = 0.05
"""
CHANGING = ("seconds",)  # all else of a report is the same at every run


@pytest.fixture(scope="module")
def points_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = file_of(tracker_points("fanuc_m6ib", 60), tmp_path_factory.mktemp("measured") / "points.csv")
    return path


def bytes_of(file: Path) -> bytes:
    return file.read_bytes()


def uploaded_file(name: str, content: bytes) -> dict[str, str]:
    return {"name": name, "content_base64": base64.b64encode(content).decode()}


def two_devices() -> tuple[bytes, bytes]:
    """Return rows that a tracker and a draw-wire measured at the same stops, and the layout that says so."""
    world = SimulatedWorld(robot="fanuc_m6ib", seed=2)
    joints = world.draw_joints(60)
    points = world.point_rows(offset=REFLECTORS[0], joints=joints).positions_m
    lengths = np.linalg.norm(
        world.tip_positions(joints, REFLECTORS[1]) - ANCHOR_M, axis=1
    ) + world.draw_noise(60)
    names = ["J1", "J2", "J3", "J4", "J5", "J6", "x", "y", "z", "wire", "stop"]
    rows = np.column_stack([np.rad2deg(joints), 1e3 * points, 1e3 * lengths, np.arange(60.0)])
    text = "\n".join([",".join(names), *(",".join(f"{value:.7f}" for value in row) for row in rows)])
    return text.encode(), TWO_DEVICES.encode()


@asynccontextmanager
async def an_engineer(folder: Path) -> AsyncIterator[ServiceClient]:
    async with open_service_client(folder) as service_client:
        assert (await service_client.from_console()).status_code == 303
        assert (await service_client.sign_in("Emil")).status_code == 200
        yield service_client


async def wait_for_end(service_client: ServiceClient, job_id: str) -> dict[str, Any]:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            answer = await service_client.client.get(f"{JOBS}/{job_id}")
            assert answer.status_code == 200, answer.text
            job: dict[str, Any] = answer.json()
            if job["state"] not in ("waiting", "running"):
                return job
            await asyncio.sleep(0.05)


async def run_job(service_client: ServiceClient, name: str, content: bytes, **wishes: Any) -> dict[str, Any]:
    begun = await service_client.post_json(JOBS, {"file": uploaded_file(name, content), "wishes": wishes})
    assert begun.status_code == 202, begun.text
    return await wait_for_end(service_client, begun.json()["id"])


async def test_a_file_is_identified_as_by_the_command_and_saved_by_an_engineer(
    tmp_path: Path, points_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line(["identify", str(points_file), "--robot", "fanuc_m6ib", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(service_client, points_file.name, bytes_of(points_file))
        assert job["state"] == "done", job
        report = job["result"]["report"]
        for key in CHANGING:
            assert printed.pop(key) > 0
            assert report.pop(key) > 0
        assert _same(report, printed)
        errors = job["result"]["row_errors"]
        assert errors["rows"] == list(range(60))
        assert max(errors["held_out_m"]) == pytest.approx(printed["held_out"]["max_m"])
        assert job["result"]["unknown"], "a tracker's place hides J1"
        assert str(tmp_path) not in json.dumps(job)

        await _is_saved_once(service_client, job, tmp_path)


def _same(found: Any, printed: Any) -> bool:
    """Tell whether two reports are equal but for rounding."""
    if isinstance(printed, dict):
        return found.keys() == printed.keys() and all(_same(found[key], printed[key]) for key in printed)
    if isinstance(printed, list):
        return len(found) == len(printed) and all(map(_same, found, printed))
    if isinstance(printed, float):
        return bool(found == pytest.approx(printed, rel=1e-6, abs=1e-12))
    return bool(found == printed)


async def _is_saved_once(service_client: ServiceClient, job: dict[str, Any], folder: Path) -> None:
    sets = ParameterSets(folder / "parameter_sets")
    save = f"{JOBS}/{job['id']}/save"
    request = {"id": "1", "newest": job["newest_version"], "note": "new gear"}
    assert job["newest_version"] == 0
    refused = await service_client.post_json(save, {**request, "newest": 3})
    assert (refused.status_code, refused.json()["code"]) == (409, "parameters.newer")
    service_client.clock.pass_by(150.0)
    locked = await service_client.post_json(save, request)
    assert (locked.status_code, locked.json()["code"]) == (401, "people.pin")
    assert sets.robot_serials() == ()
    assert (await service_client.post_json("/api/sign-in/confirm", {"secret": PINS["Emil"]})).is_success
    for _ in range(2):  # sent again after a lost answer, it saves nothing more
        saved = await service_client.post_json(save, request)
        assert saved.status_code == 200, saved.text
        head = saved.json()
        assert (head["version"], head["made_by"], head["note"]) == (1, "Emil", "new gear")
    found = sets.load_set(job["serial"])
    assert found.version == 1
    assert found.source.startswith("identification: points.csv, sha256 ")
    assert {value.name for value in found.values} >= {"J2 offset", "J3 offset"}
    assert (await service_client.client.get(f"{JOBS}/{job['id']}")).json()["saved_version"] == 1
    overview = (await service_client.client.get("/api/measurements")).json()
    assert [robot["version"] for robot in overview["robots"] if robot["serial"] == job["serial"]] == [1]


async def test_a_file_that_cannot_be_used_is_refused_in_the_words_of_the_command_line(
    tmp_path: Path, points_file: Path
) -> None:
    lines = bytes_of(points_file).decode().splitlines()
    mirrored = [lines[0], *(_with_other_sign(line, column=6) for line in lines[1:])]
    async with an_engineer(tmp_path) as service_client:
        unreadable = await run_job(service_client, "points.csv", b"\x00\x01 no table")
        misfit = await run_job(service_client, "points.csv", "\n".join(mirrored).encode())
        few = await run_job(service_client, "few.csv", "\n".join(lines[:4]).encode())
        for job in (unreadable, misfit, few):
            assert job["state"] == "failed", job
            assert job["result"] is None
            assert job["fault"]["message"]
            assert job["fault"]["remedy"]
            assert "/" not in job["fault"]["message"], "a path"
            refused = await service_client.post_json(f"{JOBS}/{job['id']}/save", {"id": "1", "newest": 0})
            assert refused.status_code == 422
        assert "mirror" in misfit["fault"]["message"] + misfit["fault"]["remedy"]


async def test_an_arm_on_a_track_is_identified_from_its_description(tmp_path: Path) -> None:
    text = (ROOT / "tests/data/descriptions/arm_on_track.urdf").read_bytes()
    hidden = HiddenArm(load_model(f"{ROOT}/tests/data/descriptions/arm_on_track.urdf?base=world&tip=tool0"))
    joints = hidden.postures(60)
    shown = np.where(hidden.slides(), joints * 1e3, np.degrees(joints))
    heads = [f"J{i + 1} ({'mm' if slides else 'deg'})" for i, slides in enumerate(hidden.slides())]
    lines = [",".join([*heads, "x (mm)", "y (mm)", "z (mm)"])]
    table = np.column_stack([shown, hidden.measured(joints) * 1e3])
    lines += [",".join(f"{value:.5f}" for value in row) for row in table.tolist()]
    request = {"file": uploaded_file("points.csv", "\n".join(lines).encode())}
    track = {"file": uploaded_file("a&b?.urdf", text), "base": "world", "tip": "tool0"}
    async with an_engineer(tmp_path) as service_client:

        async def end_of(described: dict[str, Any]) -> dict[str, Any]:
            begun = await service_client.post_json(JOBS, {**request, "description": described})
            assert begun.status_code == 202, begun.text
            return await wait_for_end(service_client, begun.json()["id"])

        job = await end_of(track)
        assert job["state"] == "done", job
        report = job["result"]["report"]
        assert report["held_out"]["rmse_m"] < 1.3 * NOISE_M * np.sqrt(3.0) < report["before"]["rmse_m"]
        assert "its parameters belong to that description" in job["result"]["not_savable"]["message"]
        saved = await service_client.post_json(f"{JOBS}/{job['id']}/save", {"id": "1", "newest": 0})
        assert saved.status_code == 422
        assert str(tmp_path) not in json.dumps(job)
        other = await end_of({**track, "tip": "no_such_link"})
        assert other["state"] == "failed"
        assert "no_such_link" in other["fault"]["message"]
        for wrong in (
            {"base": "a&tip=b"},
            {"file": uploaded_file("arm.csv", text)},
            {"file": uploaded_file("", text)},
        ):
            answer = await service_client.post_json(JOBS, {**request, "description": {**track, **wrong}})
            assert answer.status_code == 422


def _with_other_sign(line: str, column: int) -> str:
    cells = line.split(",")
    cells[column] = str(-float(cells[column]))
    return ",".join(cells)


async def test_engineers_and_administrators_begin_and_all_others_look(
    tmp_path: Path, points_file: Path
) -> None:
    request = {"file": uploaded_file("points.csv", bytes_of(points_file))}
    async with an_engineer(tmp_path) as service_client:
        begun = (await service_client.post_json(JOBS, request)).json()
        at = f"{JOBS}/{begun['id']}"
        assert (await service_client.post_json(f"{at}/stop", {})).json()["state"] == "stopped"
        for name, role in ROLES.items():
            assert (await service_client.sign_in(name)).status_code == 200
            may = role in (Role.ENGINEER, Role.ADMIN)
            assert (Right.IDENTIFY in RIGHTS[role]) == may
            for path in ("/api/measurements", at):
                assert (await service_client.client.get(path)).status_code == 200
            answers = [
                await service_client.post_json(JOBS, {**request, "robot": "none of that name"}),
                await service_client.post_json(f"{at}/stop", {}),
            ]
            statuses = [answer.status_code for answer in answers]
            assert statuses == ([422, 200] if may else [403, 403]), name


async def test_large_files_need_permission_and_have_a_limit(tmp_path: Path) -> None:
    async with an_engineer(tmp_path) as service_client:
        large = {"file": uploaded_file("a.csv", b"x" * (MOST_BYTES + 1)), "robot": "none"}
        assert "no robot" in (await service_client.post_json(JOBS, large)).json()["message"]
        larger = {"file": uploaded_file("a.csv", b"x" * ((6 << 20) + 2))}
        answer = await service_client.post_json(JOBS, larger)
        assert (answer.status_code, "larger than 6 MB" in answer.text) == (422, True)
        await service_client.sign_in("Tom")
        assert (await service_client.post_json(JOBS, large)).status_code == 413


async def test_a_job_ends_when_no_page_asks_for_it(tmp_path: Path, points_file: Path) -> None:
    async with an_engineer(tmp_path) as service_client:
        config = read_cell_file(service_client.app.state.context.settings.cell_file)
        jobs = service_client.app.state.identifications = IdentificationJobs(config, patience_s=0.05)
        request = {"file": uploaded_file("points.csv", bytes_of(points_file))}
        job = jobs.find_job((await service_client.post_json(JOBS, request)).json()["id"])
        await asyncio.wait([job.task])
        answer = (await service_client.client.get(f"{JOBS}/{job.id}")).json()
        assert (answer["state"], answer["result"]) == ("stopped", None)
        assert answer["fault"]["message"] == "no page waited for it any more."


async def test_a_file_that_takes_too_much_is_refused_in_one_sentence(
    tmp_path: Path, points_file: Path
) -> None:
    async with an_engineer(tmp_path) as service_client:
        config = read_cell_file(service_client.app.state.context.settings.cell_file)
        service_client.app.state.identifications = IdentificationJobs(config, IdentifyProcessLimits(cpu_s=1))
        many = bytes_of(points_file).decode().splitlines()
        content = "\n".join([many[0], *(many[1:] * 400)]).encode()
        job = await run_job(service_client, "points.csv", content)
        assert job["state"] == "failed"
        assert "more than 1 s of computing" in job["fault"]["message"], job["fault"]
        assert job["fault"]["remedy"]


async def _run_again(service_client: ServiceClient, job: dict[str, Any], **asked: Any) -> dict[str, Any]:
    begun = await service_client.post_json(JOBS, {"again": job["id"], **asked})
    assert begun.status_code == 202, begun.text
    return await wait_for_end(service_client, begun.json()["id"])


async def test_the_same_file_is_computed_with_another_level_and_judged_by_a_check_file(
    tmp_path: Path, points_file: Path
) -> None:
    head, *rows = bytes_of(points_file).decode().splitlines()
    check = "\n".join([head, *rows[:20]]).encode()
    async with an_engineer(tmp_path) as service_client:
        first = await run_job(service_client, points_file.name, bytes_of(points_file))
        assert first["result"]["report"]["check"] is None
        assert first["result"]["report"]["level"] != 1
        assert first["headings"] == head.split(",")
        found = await _run_again(
            service_client, first, check=uploaded_file("check.csv", check), wishes={"level": 1}
        )
        assert found["state"] == "done", found["fault"]
        report = found["result"]["report"]
        assert (found["file"], found["check"], report["level"]) == (points_file.name, "check.csv", 1)
        assert report["level_reasons"] == ["level 1, mastering offsets, was asked for"]
        assert report["check"]["n"] == 20
        # the check file goes on with the measurements
        third = await _run_again(service_client, found, wishes={"level": 2})
        assert third["result"]["report"]["check"]["n"] == 20
        assert third["result"]["report"]["level"] == first["result"]["report"]["level"]
        nothing = await service_client.post_json(JOBS, {})
        both = await service_client.post_json(
            JOBS, {"again": first["id"], "file": uploaded_file("a.csv", check)}
        )
        gone = await service_client.post_json(JOBS, {"again": "0" * 12})
        assert [each.status_code for each in (nothing, both, gone)] == [422, 422, 422]
        assert "one file" in nothing.json()["message"]
        assert "no such identification" in gone.json()["message"]


async def test_joints_of_another_file_go_with_the_readings_and_stay_with_the_next_try(
    tmp_path: Path, points_file: Path
) -> None:
    rows = [line.split(",") for line in bytes_of(points_file).decode().splitlines()]
    at = {name: place for place, name in enumerate(rows[0])}
    joints, readings = (
        "\n".join(",".join(row[at[name]] for name in names) for row in rows).encode()
        for names in (("q1", "q2", "q3", "q4", "q5", "q6"), ("x", "y", "z"))
    )
    async with an_engineer(tmp_path) as service_client:
        whole = await run_job(service_client, points_file.name, bytes_of(points_file), level=1)
        alone = await run_job(service_client, "readings.csv", readings)
        assert "Joints in another file" in alone["fault"]["message"] + alone["fault"]["remedy"]
        paired = await _run_again(
            service_client, alone, joints=uploaded_file("joints.csv", joints), wishes={"level": 1}
        )
        assert (paired["file"], paired["joints"]) == ("readings.csv", "joints.csv")
        assert {"x", "q1"} <= set(paired["headings"])
        found, expected = paired["result"]["report"], whole["result"]["report"]
        assert found["level"] == expected["level"]
        assert found["held_out"] == pytest.approx(expected["held_out"])
        again = await _run_again(service_client, paired, wishes={"level": 0})
        assert (again["joints"], again["state"]) == ("joints.csv", "done")


async def test_columns_that_no_heading_tells_are_named_by_the_page(tmp_path: Path, points_file: Path) -> None:
    head, *rows = bytes_of(points_file).decode().splitlines()
    names = [f"channel {letter}" for letter in "ABCDEFGHIJKLMNOP"[: len(head.split(","))]]
    unclear = "\n".join([",".join(names), *rows]).encode()
    async with an_engineer(tmp_path) as service_client:
        failed = await run_job(service_client, "unclear.csv", unclear)
        assert failed["state"] == "failed"
        assert failed["headings"] == names
        joints, position = names[:6], names[6:9]
        found = await _run_again(
            service_client,
            failed,
            wishes={
                "columns": {"joints": joints, "position": position},
                "units": {"joints": "deg", "position": "mm"},
                "level": 1,
            },
        )
        assert found["state"] == "done", found["fault"]
        finished = await run_job(service_client, points_file.name, bytes_of(points_file), level=1)
        assert found["result"]["understood"]["columns"] == {"joints": joints, "position": position}
        assert found["result"]["report"]["held_out"] == pytest.approx(
            finished["result"]["report"]["held_out"], rel=1e-6
        )
        columns = f"[columns]\njoints = {json.dumps(joints)}\nposition = {json.dumps(position)}\n"
        layout = columns + "[units]\njoints = 'deg'\nposition = 'mm'\n"
        same = await _run_again(
            service_client, failed, layout=uploaded_file("a.toml", layout.encode()), wishes={"level": 1}
        )
        assert same["state"] == "done", same["fault"]
        assert same["result"]["report"]["level"] == found["result"]["report"]["level"]
        assert same["result"]["report"]["held_out"] == pytest.approx(
            finished["result"]["report"]["held_out"], rel=1e-6
        )
        swapped = await _run_again(
            service_client,
            failed,
            wishes={"columns": {"joints": joints, "position": [joints[0], *position[:2]]}},
        )
        assert swapped["state"] == "failed"


async def test_readings_of_several_devices_are_identified_together_and_saved(tmp_path: Path) -> None:
    measured, layout = two_devices()
    async with an_engineer(tmp_path) as service_client:
        request = {"file": uploaded_file("plate.csv", measured), "layout": uploaded_file("cell.toml", layout)}
        begun = await service_client.post_json(JOBS, request)
        assert begun.status_code == 202, begun.text
        job = await wait_for_end(service_client, begun.json()["id"])
        assert job["state"] == "done", job["fault"]
        series = {each["name"]: each for each in job["result"]["series"]}
        assert set(series) == {"tracker", "wire"}
        for each in series.values():
            assert each["is_held_out"]
            assert each["held_out_m"] < each["before_m"] / 3
        assert job["result"]["not_savable"] is None
        await _is_saved(service_client, job, tmp_path)
        refused = await _run_again(service_client, job, wishes={"units": {"joints": "deg"}})
        assert refused["state"] == "failed"
        assert "several readings" in refused["fault"]["message"]


async def _is_saved(service_client: ServiceClient, job: dict[str, Any], folder: Path) -> None:
    saved = await service_client.post_json(f"{JOBS}/{job['id']}/save", {"id": "1", "newest": 0})
    assert saved.status_code == 200, saved.text
    found = ParameterSets(folder / "parameter_sets").load_set(job["serial"])
    assert found.source.startswith("identification of a cell: plate.csv, sha256 ")
    assert {value.name for value in found.values} >= {"J2 offset", "J3 offset"}
