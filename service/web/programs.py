"""Programs moved, cloned and compensated from a page: files in, a preview to look at, an archive to take away.

Every signed-in person may read; engineers and administrators change. Nothing is written to a robot, no source
is written over: what came along is read from a copy, and what is made goes to the page as an archive.
"""

import asyncio
from pathlib import Path as FilePath
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from starlette.requests import HTTPConnection

from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.engineering.programs.jobs.files import stored_projects
from cellcal.service.engineering.programs.jobs.jobs import Jobs
from cellcal.service.engineering.programs.jobs.shapes import (
    JobWithPreview,
    PointsPage,
    ProgramsJob,
    ProgramsOverview,
    ProgramsRequest,
    RobotOfCell,
    StoredProject,
)
from cellcal.service.people.roles import Right
from cellcal.service.web.dependencies import Who, app_context, require_right
from cellcal.service.web.error_responses import RefusalResponse
from cellcal.service.web.overlays import frames_of
from cellcal.service.web.page_jobs import JobId, jobs_lifespan, jobs_of_service

_ARCHIVE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/zip": {}}, "description": "the new programs and their reports"},
    403: {"model": RefusalResponse, "description": "the role does not include it"},
}


_JOBS = "programs"  # in the state of the application
router = APIRouter(prefix="/programs", lifespan=jobs_lifespan(_JOBS))


def jobs_of(connection: HTTPConnection) -> Jobs:
    """Return the jobs of this service."""
    return jobs_of_service(connection, _JOBS, Jobs)


@router.get("")
async def get_overview(request: Request, who: Who) -> ProgramsOverview:
    """Return the cells that programs can be made for, and what was made since the service started."""
    del who
    robots, projects = await asyncio.to_thread(_list_cells, app_context(request).config)
    return ProgramsOverview(robots=robots, projects=projects, jobs=jobs_of(request).newest_first())


@router.post(
    "/jobs",
    status_code=202,
    responses={403: {"model": RefusalResponse, "description": "the role does not include it"}},
)
async def begin_job(programs_request: ProgramsRequest, request: Request, who: Who) -> ProgramsJob:
    """Begin to make programs; `/jobs/{id}` tells how far it is, and shows what came of it."""
    require_right(who, Right.MAKE_PROGRAMS)
    return (await jobs_of(request).begin_job(programs_request, who.name)).to_response()


@router.get("/jobs/{job_id}")
async def get_job(job_id: JobId, request: Request, who: Who) -> JobWithPreview:
    """Return how a job stands, and its preview once it is done."""
    del who
    work = jobs_of(request).find_job(job_id)
    status = (
        work.to_response()
    )  # first: a job that ends in between has no preview yet, and is still told as running
    preview = await asyncio.to_thread(work.read_preview)
    return JobWithPreview(**status.model_dump(), preview=preview)


@router.post(
    "/jobs/{job_id}/stop",
    responses={403: {"model": RefusalResponse, "description": "the role does not include it"}},
)
async def stop_job(job_id: JobId, request: Request, who: Who) -> ProgramsJob:
    """Stop a job that is not done yet."""
    require_right(who, Right.MAKE_PROGRAMS)
    work = jobs_of(request).find_job(job_id)
    await jobs_of(request).stop_job(work)
    return work.to_response()


@router.get("/jobs/{job_id}/points")
async def get_points(
    job_id: JobId,
    request: Request,
    who: Who,
    program: Annotated[int | None, Query(ge=0, le=100_000)] = None,
    page: Annotated[int, Query(ge=1, le=100_000)] = 1,
) -> PointsPage:
    """Return a page of points: all worst first, or those of one program of the preview in the order of its file."""
    del who
    return await asyncio.to_thread(jobs_of(request).find_job(job_id).read_points, program, page)


@router.get("/jobs/{job_id}/programs.zip", response_class=Response, responses=_ARCHIVE)
async def get_archive(job_id: JobId, request: Request, who: Who) -> Response:
    """Return the new programs below a folder of their own, and the reports beside it."""
    require_right(who, Right.MAKE_PROGRAMS)
    work = jobs_of(request).find_job(job_id)
    content = await asyncio.to_thread(work.read_archive)
    headers = {"content-disposition": f'attachment; filename="{work.archive_name}.zip"'}
    return Response(content, media_type="application/zip", headers=headers)


def _list_cells(config: CellConfig) -> tuple[list[RobotOfCell], list[StoredProject]]:
    folder = FilePath(config.path).resolve().parent
    sets = ParameterSets(folder / FOLDER)
    serials = set(sets.robot_serials())
    robots = []
    for robot in config.robots:
        frames = frames_of(config, robot.name)
        robots.append(
            RobotOfCell(
                robot=robot.name,
                serial=robot.serial,
                model=robot.model,
                version=sets.load_set(robot.serial).version if robot.serial in serials else None,
                tools=[frame.name for frame in frames if frame.kind == "tool"],
                frames=[frame.name for frame in frames if frame.kind == "user"],
            )
        )
    return robots, _list_projects(folder)


def _list_projects(folder: FilePath) -> list[StoredProject]:
    """Return the projects beside the cell file; what they name is read when something is made."""
    found = stored_projects(folder)
    names = {path.resolve(): name for name, (path, _) in found.items()}
    projects = []
    for name, (path, table) in found.items():
        master, robot = table.get("master"), table.get("robot")
        named = master.get("project") if isinstance(master, dict) else None
        serial = robot.get("serial") if isinstance(robot, dict) else None
        theirs = names.get((path.parent / str(named)).resolve(), "") if named else ""
        projects.append(
            StoredProject(
                name=name,
                serial=serial if isinstance(serial, str) else "",
                master=theirs,
                programs=_count_programs(path, table),
                readable=bool(table),
            )
        )
    return projects


def _count_programs(path: FilePath, table: dict[str, Any]) -> int:
    """Return how many programs a project names that are there."""
    patterns = table.get("programs")
    named = [each for each in patterns if isinstance(each, str)] if isinstance(patterns, list) else []
    return len({file for each in named if each and each[0] != "/" for file in path.parent.glob(each)})
