"""A robot identified from a file of measurements that a page brings along: the figures of ``cellcal identify``.

Every signed-in person may read; engineers and administrators begin. The file is read in a limited process only. What
was found is saved as parameters of the robot on the terms of master data, and nothing is written to the robot.
"""

import asyncio
from pathlib import Path as FilePath
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field, StringConstraints
from starlette.requests import HTTPConnection

from cellcal.calibration.identification.parameters import LEVEL_NAMES
from cellcal.calibration.message import make_message
from cellcal.calibration.orientation import CONVENTIONS
from cellcal.service.cell_process.messages import Name
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.engineering.identification.jobs.jobs import (
    IdentificationJob,
    IdentificationJobs,
    newest_version,
    save_result,
)
from cellcal.service.engineering.identification.jobs.shapes import (
    IdentifyJob,
    IdentifyJobWithResult,
    IdentifyOverview,
    IdentifyRequest,
    RobotToIdentify,
)
from cellcal.service.engineering.measured.units import ANGLE_UNITS, LENGTH_UNITS
from cellcal.service.engineering.parameters.parameter_sets import FOLDER, ParameterSets
from cellcal.service.engineering.programs.jobs.shapes import MOST_FILE_BYTES
from cellcal.service.people.roles import Right
from cellcal.service.web.dependencies import Who, app_context, require_right
from cellcal.service.web.error_responses import RefusalResponse
from cellcal.service.web.page_jobs import JobId, jobs_lifespan, jobs_of_service
from cellcal.service.web.parameters import SetHead
from cellcal.service.web.rollback import NewerVersionError
from cellcal.service.web.session_control import authorize_version

_JOBS = "identifications"  # in the state of the application
router = APIRouter(prefix="/measurements", lifespan=jobs_lifespan(_JOBS))


class SaveRequest(BaseModel):
    """Save what was found, after the version that was the newest on the page."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    id: Name
    newest: Annotated[int, Field(ge=0)]
    note: Annotated[str, StringConstraints(max_length=500, strip_whitespace=True)] = ""


def identifications_of(connection: HTTPConnection) -> IdentificationJobs:
    """Return the identifications of this service."""
    return jobs_of_service(connection, _JOBS, IdentificationJobs)


@router.get("")
async def get_identify_overview(request: Request, who: Who) -> IdentifyOverview:
    """Return the robots of this cell, and what was identified since the service started."""
    del who
    robots = await asyncio.to_thread(_list_robots, app_context(request).config)
    jobs = identifications_of(request).newest_first()
    return IdentifyOverview(
        robots=robots,
        jobs=jobs,
        most_bytes=MOST_FILE_BYTES,
        levels=list(LEVEL_NAMES),
        conventions=list(CONVENTIONS),
        angle_units=list(ANGLE_UNITS),
        length_units=list(LENGTH_UNITS),
    )


@router.post(
    "/jobs",
    status_code=202,
    responses={403: {"model": RefusalResponse, "description": "the role does not include it"}},
)
async def begin_identification(identify_request: IdentifyRequest, request: Request, who: Who) -> IdentifyJob:
    """Begin to identify a robot; ``/jobs/{id}`` tells how far it is. A job about which no page asks is stopped."""
    require_right(who, Right.IDENTIFY)
    return (await identifications_of(request).begin_job(identify_request, who.name)).to_response()


@router.get("/jobs/{job_id}")
async def get_identification(job_id: JobId, request: Request, who: Who) -> IdentifyJobWithResult:
    """Return how an identification stands, and its result once it is done."""
    del who
    job = identifications_of(request).find_job(job_id)
    status = job.to_response()  # first: a job that ends in between has no result yet
    config = app_context(request).config
    result = await asyncio.to_thread(job.read_result) if status.state == "done" else None
    newest = await asyncio.to_thread(newest_version, config, job.serial)
    return IdentifyJobWithResult(**status.model_dump(), result=result, newest_version=newest)


@router.post(
    "/jobs/{job_id}/stop",
    responses={403: {"model": RefusalResponse, "description": "the role does not include it"}},
)
async def stop_identification(job_id: JobId, request: Request, who: Who) -> IdentifyJob:
    """Stop an identification that is not done yet."""
    require_right(who, Right.IDENTIFY)
    job = identifications_of(request).find_job(job_id)
    await identifications_of(request).stop_job(job)
    return job.to_response()


@router.post(
    "/jobs/{job_id}/save",
    responses={
        401: {"model": RefusalResponse, "description": "the PIN is wanted first"},
        403: {"model": RefusalResponse, "description": "the role does not include it"},
        409: {"model": RefusalResponse, "description": "a newer version, or the first of two approvals"},
    },
)
async def save_identification(job_id: JobId, requested: SaveRequest, request: Request, who: Who) -> SetHead:
    """Save what was found as the newest version of the robot's parameters."""
    context = app_context(request)
    job = identifications_of(request).find_job(job_id)
    if job.saved_version is None:
        await asyncio.to_thread(_refuse_unsavable, job, context.config, requested)
    question = make_message(
        "{robot_serial}: identification {job} after version {newest}",
        robot_serial=job.serial,
        job=job.id,
        newest=requested.newest,
    )
    name = await authorize_version(context, who, requested.id, question, requested.newest)
    async with job.saving:
        return await asyncio.to_thread(_save_once, job, context.config, name, requested)


def _list_robots(config: CellConfig) -> list[RobotToIdentify]:
    return [
        RobotToIdentify(
            robot=robot.name,
            serial=robot.serial,
            model=FilePath(robot.model).name,
            version=newest_version(config, robot.serial) or None,
        )
        for robot in config.robots
    ]


def _refuse_unsavable(job: IdentificationJob, config: CellConfig, requested: SaveRequest) -> None:
    job.read_draft()
    newest = newest_version(config, job.serial)
    if newest != requested.newest:
        raise NewerVersionError(job.serial, newest)


def _save_once(job: IdentificationJob, config: CellConfig, name: str, requested: SaveRequest) -> SetHead:
    if job.saved_version is not None:  # sent again after a lost link
        sets = ParameterSets(FilePath(config.path).parent / FOLDER)
        return SetHead.model_validate(sets.load_set(job.serial, job.saved_version))
    _refuse_unsavable(job, config, requested)  # once more: the approval may have taken its time
    return SetHead.model_validate(save_result(job, config, name, requested.note))
