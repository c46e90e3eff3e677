"""Programs made by the service: sources stay as they are, only coordinates differ, and no screen learns a path."""

import asyncio
import base64
import csv
import io
import json
import re
import shutil
import zipfile
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellcal.calibration.compensation.compensate import ProgramDirection
from cellcal.calibration.geometry import inverse_transform
from cellcal.drivers.fanuc.program_files.ls_program import read_ls
from cellcal.drivers.fanuc.program_files.programs import BRAND
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.engineering.parameters.parameter_set import parse_set
from cellcal.service.engineering.parameters.parameter_sets import ParameterSets
from cellcal.service.engineering.programs.compensate import compensation_transfer
from cellcal.service.engineering.programs.jobs.shapes import MOST_FILE_BYTES
from cellcal.service.engineering.programs.project import read_project
from cellcal.service.people.roles import RIGHTS, Right, Role
from cellcal.service.web.middleware import MOST_BYTES
from tests.example_projects import FOLDER, TOOL, example_cells, poses_of, tips_at_fixture
from tests.machine_speed import stretched_s
from tests.service.service_client import ROLES, ServiceClient, open_service_client

SOURCES = {path.name: path.read_bytes() for path in sorted((FOLDER / "cell_1" / "programs").glob("*.LS"))}
NUMBERS = re.compile(rb"([XYZWPR]) = *-?[\d.]+ +(mm|deg)")
CELL_1 = {"kind": "kept", "name": "door line, cell 1"}
CELL_7 = {"kind": "kept", "name": "door line, cell 7"}
STILL = {"position_m": [0.0, 0.0, 0.0], "quaternion": [1.0, 0.0, 0.0, 0.0]}
PATIENCE_S = stretched_s(120.0)


def uploaded_files(files: Mapping[str, bytes]) -> list[dict[str, str]]:
    return [{"name": name, "content_base64": base64.b64encode(data).decode()} for name, data in files.items()]


def project_files(folder: str, *names: str) -> list[dict[str, str]]:
    return uploaded_files({name: (FOLDER / folder / name).read_bytes() for name in names})


def without_coordinates(program: bytes) -> bytes:
    return NUMBERS.sub(rb"\1 = # \2", program)


@asynccontextmanager
async def an_engineer(folder: Path, *, projects: bool = True) -> AsyncIterator[ServiceClient]:
    if projects:
        shutil.copytree(FOLDER, folder / "projects")
    async with open_service_client(folder) as service_client:
        assert (await service_client.from_console()).status_code == 303
        assert (await service_client.sign_in("Emil")).status_code == 200
        try:
            yield service_client
        finally:
            if hasattr(service_client.app.state, "programs"):
                await service_client.app.state.programs.close_all()


async def run_job(service_client: ServiceClient, **request: Any) -> dict[str, Any]:
    begun = await service_client.post_json("/api/programs/jobs", request)
    assert begun.status_code == 202, begun.text
    async with asyncio.timeout(PATIENCE_S):
        while True:
            job: dict[str, Any] = (
                await service_client.client.get(f"/api/programs/jobs/{begun.json()['id']}")
            ).json()
            if job["state"] not in ("waiting", "running"):
                return job
            await asyncio.sleep(0.05)


async def download_result(
    service_client: ServiceClient, job: Mapping[str, Any]
) -> tuple[str, dict[str, bytes]]:
    answer = await service_client.client.get(f"/api/programs/jobs/{job['id']}/programs.zip")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/zip"
    name = re.fullmatch(r'attachment; filename="([\w-]+)\.zip"', answer.headers["content-disposition"])
    assert name is not None
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        assert archive.testzip() is None
        return name[1], {each: archive.read(each) for each in archive.namelist()}


async def test_a_clone_differs_in_coordinates_only_and_stands_where_the_master_stood(tmp_path: Path) -> None:
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(service_client, do="clone", cell=CELL_1, clone=CELL_7, own_files=True)
        assert job["state"] == "done", job
        name, files = await download_result(service_client, job)
        report = {path.rpartition("/")[2]: data for path, data in files.items() if "/report/" in path}
        new = {path.rpartition("/")[2]: data for path, data in files.items() if "/programs/" in path}

        assert new.keys() == SOURCES.keys()
        for file, source in SOURCES.items():
            source_path = tmp_path / "projects" / "cell_1" / "programs" / file
            assert source_path.read_bytes() == source, "a source was written"
            assert new[file] != source
            assert without_coordinates(new[file]) == without_coordinates(source)
            master, clone = example_cells()
            apart = tips_at_fixture(clone, new[file])[:, :3, 3] - tips_at_fixture(master, source)[:, :3, 3]
            assert np.linalg.norm(apart, axis=1).max() < 0.4e-3
        # where it is unpacked, nothing can be in the place of a source
        assert all(path.split("/")[0] == name and name.startswith("cellcal_clone_") for path in files)
        assert report.keys() == {"report.html", "report.csv", "report.json"}
        rows = list(csv.DictReader(io.StringIO(report["report.csv"].decode())))
        assert len(rows) == sum(len(poses_of(source)) for source in SOURCES.values())
        assert json.loads(report["report.json"])["counts"] == job["preview"]["counts"]
        assert str(tmp_path).encode() not in b"".join(files.values())


async def test_a_report_page_is_in_the_language_of_the_request_and_its_data_in_english(
    tmp_path: Path,
) -> None:
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(
            service_client, do="clone", cell=CELL_1, clone=CELL_7, own_files=True, language="de"
        )
        assert job["state"] == "done", job
        _, files = await download_result(service_client, job)
        report = {
            path.rpartition("/")[2]: data.decode() for path, data in files.items() if "/report/" in path
        }
        assert '<html lang="de">' in report["report.html"]
        assert "Wie weit jeder Punkt verschoben wurde" in report["report.html"]
        assert "How far" not in report["report.html"]
        assert report["report.csv"].startswith("program,point,line")
        assert " cloned to " in json.loads(report["report.json"])["title"]


async def test_a_preview_lists_old_and_new_of_every_point_by_page(tmp_path: Path) -> None:
    many = {f"SPOTS_{i}.LS": SOURCES["DOOR_SPOTS.LS"] for i in range(8)}
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(service_client, do="compensate", cell=CELL_7, files=uploaded_files(many))
        at = f"/api/programs/jobs/{job['id']}/points"
        first, second = [
            (await service_client.client.get(at, params={"page": page})).json() for page in (1, 2)
        ]
        of_one = (await service_client.client.get(at, params={"program": 3})).json()
        beyond = await service_client.client.get(at, params={"page": 3})
        files = (await download_result(service_client, job))[1]
        spec = (await service_client.client.get("/openapi.json")).json()
        bench = (await service_client.client.get("/api/programs")).json()
    _is_as_described(spec, bench, job, first)
    preview = job["preview"]
    assert (first["total"], first["pages"], preview["page_size"]) == (128, 2, 100)
    assert len(first["points"]) + len(second["points"]) == 128
    assert beyond.status_code == 422
    expected = [point["expected_m"] for point in first["points"] + second["points"]]
    assert expected == sorted(expected, reverse=True), "worst first"
    assert [point["point"] for point in of_one["points"]] == [f"P[{i + 1}]" for i in range(16)]
    file = next(
        data for path, data in files.items() if path.endswith(f"/programs/{preview['programs'][3]['file']}")
    )
    for point, before, after in zip(
        of_one["points"], poses_of(SOURCES["DOOR_SPOTS.LS"]), poses_of(file), strict=True
    ):
        assert point["before_m"] == pytest.approx(before[:3, 3], abs=1e-9)
        assert point["after_m"] == pytest.approx(after[:3, 3], abs=1e-9)
        moved = np.linalg.norm(after[:3, 3] - before[:3, 3])
        assert point["shift_m"] == pytest.approx(moved, abs=2e-6)
        assert point["verdict"] == "fits"
    picture = preview["picture"]
    assert len(picture["points"]) == 128
    assert len(picture["edges_m"]) == len(picture["colours"]) + 1
    assert {mark["step"] for mark in picture["points"]} <= set(range(len(picture["colours"])))


def _is_as_described(
    spec: dict[str, Any], bench: dict[str, Any], job: dict[str, Any], points: dict[str, Any]
) -> None:
    shapes = spec["components"]["schemas"]
    for content, shape in (
        (bench, "ProgramsOverview"),
        (bench["robots"][0], "RobotOfCell"),
        (bench["projects"][1], "StoredProject"),
        (bench["jobs"][0], "ProgramsJob"),
        (job, "JobWithPreview"),
        (job["preview"], "JobPreview"),
        (job["preview"]["picture"], "PointsPicture"),
        (points, "PointsPage"),
        (points["points"][0], "PointPreview"),
    ):
        described = shapes[shape]["properties"].keys() - {
            "messages"
        }  # which are left out where there are none
        assert content.keys() - {"messages"} == described, shape
    assert bench["projects"][1] == {
        "name": "door line, cell 7", "serial": "F-118020", "master": "door line, cell 1", "programs": 0,
        "readable": True,
    }  # fmt: skip
    answers = spec["paths"]["/api/programs/jobs/{job_id}/programs.zip"]["get"]["responses"]
    assert "application/zip" in answers["200"]["content"]
    assert {"202", "403", "422"} <= spec["paths"]["/api/programs/jobs"]["post"]["responses"].keys()


async def test_points_that_fail_are_named_and_left_and_a_bad_file_says_where_it_is_bad(
    tmp_path: Path,
) -> None:
    source = SOURCES["DOOR_SPOTS.LS"]
    bad = SOURCES["RACK_PICK.LS"].replace(b"X =   600.000  mm", b"X =   {00.000  mm", 1)
    files = uploaded_files({"DOOR_SPOTS.LS": source, "RACK_PICK.LS": bad, "NOTES.TXT": b"not a program"})
    files += uploaded_files({"door_spots.ls": source, "../../etc/cron.d/HEM.LS": SOURCES["HEM_SEAL.LS"]})
    far = {**STILL, "position_m": [0.82, 0.0, 0.0]}
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(service_client, do="move", cell=CELL_1, offset=far, frame="2", files=files)
        points = (await service_client.client.get(f"/api/programs/jobs/{job['id']}/points")).json()["points"]
        _, new = await download_result(service_client, job)
    preview = job["preview"]
    left_points = [point for point in points if point["verdict"] != "fits"]
    assert len(left_points) == preview["counts"]["left"] == preview["verdicts"]["reach"] > 0
    assert preview["counts"]["changed"] > 0
    assert all(
        point["reason"].startswith("unreachable") and point["shift_m"] is None for point in left_points
    )
    assert all(point["after_m"] == point["before_m"] for point in left_points)
    refused = {one["file"]: one for one in preview["refused"]}
    assert refused.keys() == {"RACK_PICK.LS", "NOTES.TXT", "door_spots.ls"}
    line = bad[: bad.index(b"{00")].count(b"\n") + 1
    assert refused["RACK_PICK.LS"]["line"] == line
    assert refused["RACK_PICK.LS"]["column"] > 0
    assert "{00" in refused["RACK_PICK.LS"]["message"]
    assert all(one["remedy"] for one in preview["refused"])
    assert {path.rpartition("/")[2] for path in new if "/programs/" in path} == {"DOOR_SPOTS.LS", "HEM.LS"}
    assert any("PR[1]" in note for note in preview["notes"])
    assert any("user frame 2" in note for note in preview["notes"])
    assert preview["collisions_checked"] is False
    _stand_at_the_moved_work(
        points, next(data for path, data in new.items() if path.endswith("DOOR_SPOTS.LS"))
    )


@pytest.mark.parametrize(("frame", "findings"), [(2, 0), (0, 1)])
async def test_programs_of_one_upload_count_for_each_other(tmp_path: Path, frame: int, findings: int) -> None:
    """A copy of a place is gone to in the frame that another program of the upload chooses."""
    spots = SOURCES["DOOR_SPOTS.LS"]
    copy = b"PR[9]=P[1] ;\n  19:  CALL DEEP    ;\n  20:L PR[9] 100mm/sec FINE    ;\n  21:L P[14]"
    deep = spots[: spots.index(b"/MN")].replace(b"DOOR_SPOTS", b"DEEP")
    deep += b"/MN\n   1:  UFRAME_NUM=%d ;\n/POS\n/END\n" % frame
    files = {"DOOR_SPOTS.LS": spots.replace(b"  18:L P[14]", b"  18:  " + copy), "DEEP.LS": deep}
    turn = {"position_m": [0.01, 0.0, 0.0], "quaternion": [np.cos(0.03), 0.0, 0.0, np.sin(0.03)]}
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(
            service_client, do="move", cell=CELL_1, offset=turn, frame="2", files=uploaded_files(files)
        )
        _, new = await download_result(service_client, job)
    report = json.loads(next(data for path, data in new.items() if path.endswith("report.json")))
    assert report["finding_count"] == findings


def _stand_at_the_moved_work(points: list[dict[str, Any]], program: bytes) -> None:
    """See that every point that moved keeps its place at work that was moved by 820 mm along x of frame 2."""
    fitting = {
        point["point"] for point in points if point["verdict"] == "fits" and point["program"] == "DOOR_SPOTS"
    }
    rows = [i for i in range(16) if f"P[{i + 1}]" in fitting]
    master, shift = example_cells()[0], np.eye(4)
    shift[0, 3] = 0.82
    change = master.entered_frame @ shift @ inverse_transform(master.entered_frame)
    before, after = (tips_at_fixture(master, each) for each in (SOURCES["DOOR_SPOTS.LS"], program))
    expected_tips = inverse_transform(master.base_fixture) @ change @ master.base_fixture @ before
    assert rows
    assert np.linalg.norm((expected_tips - after)[rows, :3, 3], axis=1).max() < 0.3e-3


async def test_a_project_that_came_along_gives_the_same_and_names_nothing_else(tmp_path: Path) -> None:
    project = project_files("cell_7", "project.toml", "robot.toml", "door_fixture.aln.json")
    files = uploaded_files(SOURCES)
    (tmp_path / "secret.toml").write_text("[[parameter]]\nname = 'secret'\n", encoding="utf-8")
    text = (FOLDER / "cell_7" / "project.toml").read_text(encoding="utf-8")
    async with an_engineer(tmp_path) as service_client:
        job = await run_job(
            service_client, do="compensate", cell={"kind": "carried", "files": project}, files=files
        )
        new = {
            path.rpartition("/")[2]: data
            for path, data in (await download_result(service_client, job))[1].items()
        }
        for named in (str(tmp_path / "secret.toml"), "../../secret.toml", "missing.toml"):
            project_text = text.replace('"robot.toml"', json.dumps(named))
            cell = {
                "kind": "carried",
                "files": [*uploaded_files({"project.toml": project_text.encode()}), *project[1:]],
            }
            answer = await service_client.post_json(
                "/api/programs/jobs", {"do": "compensate", "cell": cell, "files": files}
            )
            assert answer.status_code == 422
            assert "did not come along" in answer.json()["message"]
        for line in (f'backup = "{tmp_path}"', f'parameter_store = "{tmp_path}"'):
            project_text = text.replace("[robot]", f"[robot]\n{line}")
            cell = {
                "kind": "carried",
                "files": [*uploaded_files({"project.toml": project_text.encode()}), *project[1:]],
            }
            answer = await service_client.post_json(
                "/api/programs/jobs", {"do": "compensate", "cell": cell, "files": files}
            )
            assert "a folder of the service's computer" in answer.json()["message"]
    cell = read_project(FOLDER / "cell_7" / "project.toml")
    carrier = compensation_transfer(cell, ProgramDirection.UPLOAD, BRAND.configurations)
    for name, source in SOURCES.items():
        assert new[name] == carrier.transfer_programs([read_ls(name, source)])[0].after.to_bytes()


async def test_this_cell_compensates_by_its_own_parameters_and_entered_tools(tmp_path: Path) -> None:
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    text = path.read_text(encoding="utf-8").replace('model = "fanuc_m6ib"', 'model = "fanuc_r2000ic_165f"')
    tool = {"name": "1", "position_m": TOOL[:3, 3].tolist(), "quaternion": [2.0, 0.0, 0.0, 0.0]}
    frame = {**STILL, "name": "2", "position_m": example_cells()[0].entered_frame[:3, 3].tolist()}
    other = SOURCES["RACK_PICK.LS"].replace(b"UT : 1,", b"UT : 3,")
    files = uploaded_files({"HEM_SEAL.LS": SOURCES["HEM_SEAL.LS"], "RACK_PICK.LS": other})
    async with an_engineer(tmp_path) as service_client:
        path.write_text(text, encoding="utf-8")
        robot = next(each for each in read_cell_file(path).robots if each.name == "fanuc")
        here = {"kind": "here", "name": "fanuc", "tools": [tool], "frames": [frame]}
        without = await run_job(service_client, do="compensate", cell=here, files=files)
        _save_parameters(tmp_path, robot.serial)
        job = await run_job(service_client, do="compensate", cell=here, files=files)
        robot_entry = (await service_client.client.get("/api/programs")).json()["robots"][0]
    assert without["fault"]["message"] == f"no parameters of {robot.serial} were saved in this cell."
    assert robot_entry["version"] == 1
    assert job["preview"]["parameters"].startswith(f"{robot.serial}, 1, ")
    assert job["preview"]["collisions_checked"] is True  # the cell file tells of a floor
    assert job["preview"]["counts"] == {"changed": 20, "unchanged": 0, "left": 4}
    assert job["preview"]["verdicts"]["unknown"] == 4, "tool 3 is unknown"


def _save_parameters(folder: Path, serial: str) -> None:
    found = parse_set((FOLDER / "cell_1" / "robot.toml").read_text(encoding="utf-8"), "robot.toml")
    assert found.robot_serial == serial
    ParameterSets(folder / "parameter_sets").save_draft(found)


async def test_engineers_and_administrators_make_and_all_others_look(tmp_path: Path) -> None:
    request = {"do": "compensate", "cell": CELL_7, "files": uploaded_files({"A.LS": SOURCES["RACK_PICK.LS"]})}
    async with an_engineer(tmp_path) as service_client:
        at = f"/api/programs/jobs/{(await run_job(service_client, **request))['id']}"
        for name, role in ROLES.items():
            assert (await service_client.sign_in(name)).status_code == 200
            may = role in (Role.ENGINEER, Role.ADMIN)
            assert (Right.MAKE_PROGRAMS in RIGHTS[role]) == may
            for path in ("/api/programs", at, f"{at}/points"):
                assert (await service_client.client.get(path)).status_code == 200
            lacking = await service_client.post_json("/api/programs/jobs", {**request, "files": []})
            stopped, archive = (
                await service_client.post_json(f"{at}/stop", {}),
                await service_client.client.get(f"{at}/programs.zip"),
            )
            answers = [answer.status_code for answer in (lacking, stopped, archive)]
            assert answers == ([422, 200, 200] if may else [403, 403, 403]), name
            assert lacking.json()["code"] == ("usage" if may else "people.role")


async def test_large_uploads_need_permission_and_have_a_limit(tmp_path: Path) -> None:
    async with an_engineer(tmp_path) as service_client:
        large = uploaded_files({"A.LS": b"x" * (MOST_BYTES + 1)})
        request = {"do": "clone", "cell": CELL_7, "files": large}
        assert (
            "two cells" in (await service_client.post_json("/api/programs/jobs", request)).json()["message"]
        )
        halves = dict.fromkeys(("A.LS", "B.LS"), b"x" * (MOST_FILE_BYTES // 2 + 1))
        answer = await service_client.post_json(
            "/api/programs/jobs", {**request, "do": "compensate", "files": uploaded_files(halves)}
        )
        assert (answer.status_code, "larger than 6 MB" in answer.text) == (422, True)
        await service_client.sign_in("Tom")
        assert (await service_client.post_json("/api/programs/jobs", request)).status_code == 413


@pytest.mark.parametrize(
    ("job_request", "sentence"),
    [
        ({"do": "compensate", "cell": CELL_7}, "no program came along"),
        ({"do": "move", "cell": CELL_7, "own_files": True}, "a move takes an offset"),
        ({"do": "clone", "cell": CELL_7, "own_files": True}, "a clone takes two cells"),
        ({"do": "compensate", "cell": {"kind": "here"}, "own_files": True}, "only a project"),
        (
            {"do": "compensate", "cell": {"kind": "kept", "name": "../x"}, "own_files": True},
            "no such project",
        ),
        (
            {"do": "compensate", "cell": {**CELL_7, "tools": [{**STILL, "name": "1"}]}, "own_files": True},
            "names its own",
        ),
    ],
)
async def test_what_does_not_fit_together_is_refused_at_once(
    tmp_path: Path, job_request: dict[str, Any], sentence: str
) -> None:
    async with an_engineer(tmp_path) as service_client:
        answer = await service_client.post_json("/api/programs/jobs", job_request)
        assert answer.status_code == 422
        assert sentence in answer.json()["message"]
        assert answer.json()["remedy"]
        assert (await service_client.client.get("/api/programs")).json()["jobs"] == []


async def test_a_job_can_be_stopped_and_leaves_nothing(tmp_path: Path) -> None:
    async with an_engineer(tmp_path) as service_client:
        request = {"do": "compensate", "cell": CELL_7, "files": uploaded_files(SOURCES)}
        begun = (await service_client.post_json("/api/programs/jobs", request)).json()
        folder = service_client.app.state.programs.find_job(begun["id"]).folder
        assert folder.is_dir()
        stopped = (await service_client.post_json(f"/api/programs/jobs/{begun['id']}/stop", {})).json()
        assert stopped["state"] == "stopped"
        assert (
            await service_client.client.get(f"/api/programs/jobs/{begun['id']}/programs.zip")
        ).status_code == 422
        assert (
            await service_client.client.get(f"/api/programs/jobs/{begun['id']}/points")
        ).status_code == 422
        await service_client.app.state.programs.close_all()
        assert not folder.exists()
