"""A working day in a browser: every procedure of a FANUC, from its page to its certificate, over sockets."""

import asyncio
import os
import tempfile
from collections.abc import Iterable
from itertools import cycle, islice
from pathlib import Path

from rich.console import Console
from rich.progress import track

from cellcal.procedures.catalogue import CATALOGUE
from cellcal.service.cli.certificate import verify
from tests.soak.campaign_figures import CampaignFigures
from tests.stories.browser_technician import ProcedureStory, StoryEnd, working_day
from tests.stories.catalogue_day import day_stories

OTHER_ROBOTS = {"position_record", "position_cure"}  # of ABB, Yaskawa and KUKA; see guided_cures
LOCALES = "en-US", "de-DE", "es-ES", "zh-CN"


def day(days: int) -> CampaignFigures:
    """Every procedure passes, its certificate holds; the recovery after every battery was lost. Pictures are kept.

    Each day is told in the next of the four languages.
    """
    expected = set(CATALOGUE) - OTHER_ROBOTS
    lines, missed, pictures = [], [], _picture_folder()
    for locale in islice(cycle(LOCALES), days):
        passed = set()
        ended, english = asyncio.run(_whole_day(pictures, locale))
        missed += [f"left in English in {locale}: {each}" for each in sorted(english)]
        for end in ended:
            if end.verdict == "PASS" and end.certificate is not None:
                passed.add(end.procedure_story.procedure)
            else:
                missed.append(
                    f"{end.procedure_story.procedure} of {end.procedure_story.robot} in {locale}: {end.words}"
                )
        missed += [f"{each} in {locale}: not told" for each in sorted(expected - passed)]
        lines.append(f"{len(passed)} in {locale}")
    line = (
        f"day: of {len(expected)} procedures told in a browser, so many to a PASS and a certificate that holds: "
        f"{', '.join(lines)}; pictures in {pictures}{'; '.join(['', *missed])}"
    )
    return CampaignFigures(line, not missed)


def _picture_folder() -> Path:
    """Return the folder for the pictures: the one that CELLCAL_PICTURES names, else a new one."""
    if not (named := os.environ.get("CELLCAL_PICTURES")):
        return Path(tempfile.mkdtemp(prefix="cellcal-day-"))
    Path(named).mkdir(parents=True, exist_ok=True)
    return Path(named)


async def _whole_day(pictures: Path, locale: str) -> tuple[list[StoryEnd], set[str]]:
    picture_folder = pictures / locale
    picture_folder.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        async with working_day(Path(folder), picture_folder, locale=locale) as day:
            ended = []
            for story in _ordered_stories(day_stories()):
                if story.procedure == "mastering_recovery":
                    await day.actions.fake_client.inject_fault("battery_loss", device=story.robot)
                ended.append(await day.run_story(story))
        certificate_folder = Path(folder) / "data" / "certificates"
        assert all(verify(certificate_folder / end.certificate) == 0 for end in ended if end.certificate)
        return ended, day.english


def _ordered_stories(day: tuple[ProcedureStory, ...]) -> Iterable[ProcedureStory]:
    return track(day, description="procedures", console=Console(stderr=True))
