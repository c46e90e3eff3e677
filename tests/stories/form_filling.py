"""Filling in a procedure's form: every setting is typed where the page has its field, in the unit that it shows."""

import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from playwright.async_api import FilePayload, Locator, Page

from cellcal.calibration.geometry import Pose

SHOWN = {"mm": 1e3, "mm/s": 1e3, "°": 180.0 / math.pi, "°/s": 180.0 / math.pi}  # a unit's count in one of SI


async def fill_in(page: Page, settings: Mapping[str, Any], within: str = "") -> None:
    """Fill in the fields of all settings that are told; the others stand at their usual value."""
    drawer = page.get_by_test_id("all-settings")
    if not within and await drawer.count():
        await drawer.evaluate(
            "drawer => { drawer.open = true; }"
        )  # what a technician does not know is an engineer's
    for name, value in settings.items():
        path = f"{within}{name}"
        await _fill_setting(page, path, value)


async def _fill_setting(page: Page, path: str, value: Any) -> None:
    field = page.get_by_test_id(f"setting-{path}")
    kind = await field.get_attribute("data-kind")
    if kind in ("number", "integer"):
        await _type_number(page, field, f"value-{path}", value)
    elif kind == "text":
        await page.get_by_test_id(f"value-{path}").fill(value)
        await page.get_by_test_id(f"value-{path}").press("Tab")
    elif kind == "yesno":
        await field.get_by_role("checkbox").set_checked(value)
    elif kind == "choice":
        await page.get_by_test_id(f"value-{path}").select_option(value)
    elif kind == "group":
        await field.locator("summary").first.click()
        await fill_in(page, value, f"{path}.")
    elif kind == "triple":
        await _fill_point(page, field, f"{path}-0", value)
    elif kind == "triples":
        await _fill_points(page, field, path, value)
    elif kind == "pose":
        await _fill_pose(page, field, path, value)
    elif kind == "file":
        await _choose_file(page, path, value)
    else:
        raise AssertionError(f"it is not defined how to fill in {path}, of kind {kind}")


async def _type_number(page: Page, field: Locator, test_id: str, si: float) -> None:
    """Type a number in the unit that stands beside its field; who is asked says that it is meant."""
    box = page.get_by_test_id(test_id)
    label = field.locator("label").filter(has=box)
    units = await label.get_by_test_id("unit").all_inner_texts()
    await box.fill(f"{si * SHOWN.get(units[0] if units else '', 1.0):.12g}")
    await box.press("Tab")
    sure = field.get_by_test_id("unit-sure")
    if await sure.count():
        await sure.click()


async def _fill_point(page: Page, field: Locator, row: str, point: Sequence[float]) -> None:
    for axis, value in zip("xyz", point, strict=True):
        await _type_number(page, field, f"{row}-{axis}", value)


async def _fill_points(page: Page, field: Locator, path: str, points: Sequence[Sequence[float]]) -> None:
    rows = field.locator(".point")  # the form remembers what was typed for the run before
    for row, point in enumerate(points):
        if await rows.count() <= row:
            await page.get_by_test_id(f"{path}-add").click()
        await _fill_point(page, field, f"{path}-{row}", point)


async def _fill_pose(page: Page, field: Locator, path: str, pose_value: Mapping[str, Any]) -> None:
    pose = Pose(tuple(pose_value["position_m"]), tuple(pose_value.get("quaternion", (1.0, 0.0, 0.0, 0.0))))
    await _fill_point(page, field, f"{path}-0", pose.position_m)
    for axis, angle_rad in enumerate(_turns_rad(pose)):
        await _type_number(page, field, f"{path}-turn-{axis}", angle_rad)


def _turns_rad(pose: Pose) -> tuple[float, float, float]:
    """Return the angles about the fixed axes x, y, z, as pendants show them."""
    rotation = np.asarray(pose.rotation_matrix())
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        math.asin(-rotation[2, 0]) + 0.0,  # and no minus before a zero
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


async def _choose_file(page: Page, path: str, file_setting: Mapping[str, Any]) -> None:
    file = file_setting.get("file", file_setting)
    content = base64.b64decode(file["content_base64"])
    chosen: FilePayload = {"name": file["name"], "mimeType": "text/csv", "buffer": content}
    await page.get_by_test_id(f"value-{path}").set_input_files([chosen])
    if unit := file_setting.get("units", {}).get("position"):
        await page.get_by_test_id(f"{path}-unit-position").select_option(unit)
