"""Figures and results as a reader of a certificate sees them: conditions are yes or no, speeds have their unit."""

from typing import Any

import pytest

from cellcal.service.certificates.certificate_texts import describe_figure, short_facts
from cellcal.service.certificates.setting_rows import setting_rows


def figure(**changes: Any) -> dict[str, Any]:
    base = {
        "name": "search and rounding find the same whole turns",
        "value": 1.0,
        "unit": "1",
        "limit": 1.0,
        "expanded_uncertainty": 0.0,
        "coverage": 2.0,
        "decision": "pass",
        "rule": "search and rounding agree",
        "budget": [],
    }
    return base | changes


@pytest.mark.parametrize(
    ("changes", "found", "limit"),
    [
        ({}, "yes", ""),
        ({"value": 0.0, "decision": "fail"}, "no", ""),
        ({"limit": 0.9999}, "1", "0.9999"),
        ({"value": 0.5}, "0.5", "1"),
        ({"decision": None}, "1", "1"),
    ],
)
def test_a_condition_is_yes_or_no_and_a_number_stays_one(
    changes: dict[str, Any], found: str, limit: str
) -> None:
    texts = describe_figure(figure(**changes))
    assert (texts.found, texts.limit) == (found, limit)


def test_speeds_of_a_result_and_of_settings_have_their_unit() -> None:
    facts = dict(short_facts({"jog_speed_rad_s": 0.034907, "crawl_m_s": 0.05, "odd_rad": 0.1}))
    assert facts == {"slow speed of the axes": "2.0000 deg/s", "crawl": "50.000 mm/s", "odd": "5.7296 deg"}
    values = dict(setting_rows("mastering_recovery", {"jog_speed_rad_s": 0.034907}))
    assert list(values.values()) == ["2.0000 deg/s"]
