"""Filling in a procedure's form: every setting is found by its label and typed in the unit that stands beside it."""

import base64
import math
import re
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from playwright.async_api import FilePayload, Locator, Page

from cellcal.calibration.geometry import Pose
from tests.stories.page_words import PageWords

SHOWN = {"mm": 1e3, "mm/s": 1e3, "°": 180.0 / math.pi, "°/s": 180.0 / math.pi}  # a unit's count in one of SI
_UNIT = re.compile(r"(?:mm/s|mm|°/s|°)(?![\w/])")
_AXES, _TURNS = ("x", "y", "z"), ("W (x)", "P (y)", "R (z)")


class FormFiller:
    """A person who fills in the form of a procedure; knows only what the page shows, in the page's language."""

    def __init__(self, page: Page, words: PageWords) -> None:
        self._page, self._words = page, words

    async def fill_in(self, settings: Mapping[str, Any]) -> None:
        """Fill in the settings, given by their English labels in SI units; the others stay at their usual value."""
        main = self._page.get_by_role("main")
        drawer = main.locator("summary", has_text=self._words.word("for_the_engineer"))
        if await drawer.count():
            await drawer.click()  # what a technician does not know is an engineer's
        await self._fill_group(main, settings)

    async def _fill_group(self, place: Locator, settings: Mapping[str, Any]) -> None:
        for english, value in settings.items():
            await self._fill_setting(place, self._words.translate(english), value)

    async def _fill_setting(self, place: Locator, label: str, value: Any) -> None:
        if isinstance(value, bool):
            await place.get_by_role("checkbox", name=label, exact=True).set_checked(value)
        elif isinstance(value, int | float):
            await self._type_number(await self._find_field(place, label, "textbox"), value)
        elif isinstance(value, str):
            await self._fill_text(place, label, value)
        elif isinstance(value, Mapping):
            await self._fill_parts(place, label, value)
        elif isinstance(value[0], int | float):
            await self._fill_point(await self._find_group(place, label), 0, value)
        else:
            await self._fill_points(await self._find_group(place, label), value)

    async def _find_field(self, place: Locator, label: str, role: Literal["textbox", "combobox"]) -> Locator:
        return await self._find_named(place.get_by_role(role, name=label), _label_text, label)

    async def _find_group(self, place: Locator, label: str) -> Locator:
        return await self._find_named(place.get_by_role("group", name=label), _legend_text, label)

    async def _find_named(
        self, found: Locator, read_name: Callable[[Locator], Awaitable[str]], label: str
    ) -> Locator:
        """Return the one that has this label, where some have it as a part of theirs."""
        notes = (self._words.word("needed"), *SHOWN)
        fitting = []
        for one in await found.all():
            name = await read_name(one)
            for _ in range(2):
                for note in notes:
                    name = name.removesuffix(note).strip()
            if name == label:
                fitting.append(one)
        assert len(fitting) == 1, f"{len(fitting)} fields are called {label!r}"
        return fitting[0]

    async def _fill_text(self, place: Locator, label: str, value: str) -> None:
        if await place.get_by_role("combobox", name=label).count():
            field = await self._find_field(place, label, "combobox")
            await field.select_option(label=self._words.translate(value))
        else:
            field = await self._find_field(place, label, "textbox")
            await field.fill(value)
            await field.press("Tab")

    async def _fill_parts(self, place: Locator, label: str, value: Mapping[str, Any]) -> None:
        if "position_m" in value:
            await self._fill_pose(await self._find_group(place, label), value)
        elif "file" in value or "content_base64" in value:
            await self._choose_file(place, label, value)
        else:
            summary = place.locator("summary").filter(has_text=re.compile(rf"^\s*{re.escape(label)}"))
            await summary.click()
            await self._fill_group(summary.locator("xpath=.."), value)

    async def _type_number(self, field: Locator, si: float) -> None:
        """Type a number in the unit that stands beside its field; a page that doubts is told that it is meant."""
        unit = _UNIT.search(await _label_text(field))
        text = f"{si * SHOWN.get(unit[0] if unit else '', 1.0):.12g}"
        await field.fill(text)
        await field.press("Tab")
        unit_text = unit[0] if unit else ""
        meant = self._words.word("step_unit_sure", typed=text, unit=unit_text)
        button = self._page.get_by_role("button", name=meant, exact=True)
        if await button.count():
            await button.click()

    async def _fill_point(self, group: Locator, row: int, point: Sequence[float]) -> None:
        for axis, value in zip(_AXES, point, strict=True):
            fields = group.get_by_role("textbox", name=re.compile(rf"^{axis}( |$)"))
            await self._type_number(fields.nth(row), value)

    async def _fill_points(self, group: Locator, points: Sequence[Sequence[float]]) -> None:
        rows = group.get_by_role("textbox", name=re.compile(r"^x( |$)"))  # the form remembers the last run's
        for row, point in enumerate(points):
            if await rows.count() <= row:
                await group.get_by_role("button", name=self._words.word("step_add")).click()
            await self._fill_point(group, row, point)

    async def _fill_pose(self, group: Locator, value: Mapping[str, Any]) -> None:
        pose = Pose(tuple(value["position_m"]), tuple(value.get("quaternion", (1.0, 0.0, 0.0, 0.0))))
        await self._fill_point(group, 0, pose.position_m)
        for axis, angle_rad in zip(_TURNS, _turns_rad(pose), strict=True):
            await self._type_number(group.get_by_role("textbox", name=axis), angle_rad)

    async def _choose_file(self, place: Locator, label: str, value: Mapping[str, Any]) -> None:
        file = value.get("file", value)
        content = base64.b64decode(file["content_base64"])
        chosen: FilePayload = {"name": file["name"], "mimeType": "text/csv", "buffer": content}
        chooser = place.get_by_label(label, exact=True)
        await chooser.set_input_files([chosen])
        if unit := value.get("units", {}).get("position"):
            units = place.get_by_role("combobox", name=self._words.word("file_unit_position"), exact=True)
            below = [one for one in await units.all() if await _stands_below(one, chooser)]
            await below[0].select_option(label=unit)


async def _label_text(field: Locator) -> str:
    """Return what a field is called, with what is written beside it."""
    # a list's choices stand in its label, too
    text: str = await field.evaluate(
        "field => (field.tagName === 'SELECT' ? field.labels[0].querySelector('span') : field.labels[0]).innerText"
    )
    return " ".join(text.split())


async def _legend_text(group: Locator) -> str:
    text: str = await group.evaluate("group => group.querySelector('legend').innerText")
    return " ".join(text.split())


async def _stands_below(one: Locator, other: Locator) -> bool:
    here, there = await one.bounding_box(), await other.bounding_box()
    assert here is not None
    assert there is not None
    return here["y"] > there["y"]


def _turns_rad(pose: Pose) -> tuple[float, float, float]:
    """Return the angles about the fixed axes x, y, z, as pendants show them."""
    rotation = np.asarray(pose.rotation_matrix())
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        math.asin(-rotation[2, 0]) + 0.0,  # and no minus before a zero
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )
