"""A working day in a browser: every procedure of the catalogue, from its page to its certificate, over sockets."""

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
from tests.soak.figures import Figures
from tests.stories.catalogue_day import stories
from tests.stories.days import Ended, Story, working_day

LOCALES = "en-US", "de-DE", "es-ES", "zh-CN"


def day(days: int) -> Figures:
    """Every procedure passes, its certificate holds; the recovery after every battery was lost. Pictures are kept.

    Each day is told in the next of the four languages.
    """
    wanted, told, missed, pictures = set(CATALOGUE), [], [], _kept_in()
    for locale in islice(cycle(LOCALES), days):
        passed = set()
        ended, english = asyncio.run(_whole_day(pictures, locale))
        missed += [f"left in English in {locale}: {each}" for each in sorted(english)]
        for end in ended:
            if end.verdict == "pass" and end.certificate is not None:
                passed.add(end.story.procedure)
            else:
                missed.append(f"{end.story.procedure} of {end.story.robot} in {locale}: {end.words}")
        missed += [f"{each} in {locale}: not told" for each in sorted(wanted - passed)]
        told.append(f"{len(passed)} in {locale}")
    line = (
        f"day: of {len(wanted)} procedures told in a browser, so many to a PASS and a certificate that holds: "
        f"{', '.join(told)}; pictures in {pictures}{'; '.join(['', *missed])}"
    )
    return Figures(line, not missed)


def _kept_in() -> Path:
    """Return the folder for the pictures: the one that CELLCAL_PICTURES names, else a new one."""
    if not (named := os.environ.get("CELLCAL_PICTURES")):
        return Path(tempfile.mkdtemp(prefix="cellcal-day-"))
    Path(named).mkdir(parents=True, exist_ok=True)
    return Path(named)


async def _whole_day(pictures: Path, locale: str) -> tuple[list[Ended], set[str]]:
    seen = pictures / locale
    seen.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        async with working_day(Path(folder), seen, locale=locale) as day:
            ended = []
            for story in _told(stories()):
                if story.procedure == "mastering_recovery":
                    await day.hands.door.inject_fault("battery_loss", device=story.robot)
                ended.append(await day.tell(story))
        kept = Path(folder) / "data" / "certificates"
        assert all(verify(kept / end.certificate) == 0 for end in ended if end.certificate)
        return ended, day.english


def _told(day: tuple[Story, ...]) -> Iterable[Story]:
    return track(day, description="procedures", console=Console(stderr=True))
