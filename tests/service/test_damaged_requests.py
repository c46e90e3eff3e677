"""Damaged requests at every route: an answer in JSON that is no 500, and that names no folder of the computer."""

import json
import re
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import httpx
import pytest

from tests.service.service_client import another_browser, open_service_client
from tests.service.test_guard_routes import BODIES, own_routes, sign_in_as
from tests.soak.input_mutations import NASTY_WORDS, mutated_input

CASES = 6
_EXAMPLE = {
    "rev": 1,
    "id": "a" * 32,
    "order": {"op": "start", "procedure": "x", "settings": {"a": [1.5, None]}},
}


@pytest.mark.parametrize("who", ["engineer", "a device alone"])
async def test_no_damaged_request_breaks_the_service(tmp_path: Path, who: str) -> None:
    wrong = []
    async with open_service_client(tmp_path) as service_client:
        routes = sorted(own_routes(service_client.app) - {("WS", "/api/screen"), ("GET", "/")})
        for number, (method, path) in enumerate(routes):
            async with another_browser(service_client.app, address=f"127.0.2.{number}") as browser:
                await sign_in_as(replace(service_client, client=browser), who)
                for seed in range(CASES):
                    answer = await _send_damaged(browser, method, path, seed + 1000 * number)
                    if (
                        (answer.status_code >= 500 and not _is_stop_without_cell(answer))
                        or str(tmp_path) in answer.text
                        or "Traceback" in answer.text
                    ):
                        wrong.append((method, path, seed, answer.status_code, answer.text[:200]))
    assert wrong == []


def _is_stop_without_cell(answer: httpx.Response) -> bool:
    """Tell whether a damaged order was still a stop: no cell's process runs here, and that must be said."""
    return answer.status_code == 503 and answer.json()["code"] == "desk.stop_unconfirmed"


async def _send_damaged(browser, method: str, path: str, seed: int):
    word = NASTY_WORDS[seed % len(NASTY_WORDS)][:200]
    filled = re.sub(r"\{\w+\}", lambda _: quote(word, safe=""), path)
    query = {
        name: word.decode("latin-1")
        for name in ("before", "most", "page", "robot", "what", "version", "limit")
    }
    if method == "GET":
        return await browser.get(filled, params=query if seed % 2 else None)
    body = mutated_input(json.dumps(BODIES.get(path, _EXAMPLE)).encode(), seed)[:200_000]
    return await browser.request(method, filled, content=body, headers={"content-type": "application/json"})
