"""The short stories of the day; the whole day is a campaign (``make soak ARGS=day``)."""

from pathlib import Path

import pytest

from service.cli.certificate import verify
from tests.stories.catalogue_day import QUICK, stories
from tests.stories.days import working_day

pytestmark = pytest.mark.xdist_group("pages")


async def test_a_technician_teaches_tool_frame_and_workpiece_and_places_a_simulated_base(
    tmp_path: Path,
) -> None:
    async with working_day(tmp_path) as day:
        ended = [await day.tell(story) for story in stories() if story.procedure in QUICK]
    assert [(end.story.procedure, end.verdict) for end in ended] == [(name, "pass") for name in QUICK]
    for end in ended:
        assert end.certificate is not None
        assert verify(tmp_path / "data" / "certificates" / end.certificate) == 0
