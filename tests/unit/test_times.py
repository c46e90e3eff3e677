"""A time without a zone is no moment: every file and message that carries one is refused."""

import ast
from pathlib import Path

import pytest
from pydantic import ValidationError

from cellcal.service.engineering.parameters.parameter_set import (
    ParameterSet,
    ParameterSetError,
    ParameterValue,
)
from cellcal.service.site.link_files import EnrolledCell
from cellcal.service.site.state_shape import StateCertificate, StateDrift, StateDue
from cellcal.service.times import has_time_zone, read_time

ROOT = Path(__file__).parents[2]
ZONED = ["2026-05-04T08:30:00+02:00", "2026-05-04T08:30:00Z", "2026-05-04T08:30:00.123456+00:00"]
NONE = ["2026-05-04T08:30:00", "2026-05-04", "", "yesterday", "2026-13-01T00:00:00Z", "08:30:00+00:00", "1e9"]
MODELS = {
    EnrolledCell: ("enrolled_utc", {"public_key": "k"}),
    StateDrift: ("ended_utc", {"run_id": "r", "change_rms_m": 0.0, "change_max_m": None, "word": "pass"}),
    StateCertificate: ("ended_utc", {"run_id": "r", "procedure": "p", "word": "pass"}),
}
READERS = {"service/times.py"}
OWN = {  # days cut from times that this program wrote itself, or of a model that has checked them
    "service/certificates/certificate.py",
    "service/engineering/controller_files/file_changes.py",
    "service/export/cell_metrics.py",
    "service/record/drift_schedule.py",
    "service/site/cell_state.py",
}


@pytest.mark.parametrize("text", [*ZONED, *NONE])
def test_a_time_has_a_zone_or_is_refused(text: str) -> None:
    assert has_time_zone(text) is (text in ZONED)
    if text in NONE:
        with pytest.raises(ValueError, match=r"."):
            read_time(text)


@pytest.mark.parametrize("text", [*ZONED, *NONE])
@pytest.mark.parametrize("model", MODELS)
def test_models_that_are_read_take_no_other(model: type, text: str) -> None:
    name, rest = MODELS[model]
    if text in ZONED:
        assert getattr(model(**rest, **{name: text}), name) == text
    else:
        with pytest.raises(ValidationError):
            model(**rest, **{name: text})


@pytest.mark.parametrize("text", NONE)
def test_a_parameter_set_takes_no_other(text: str) -> None:
    with pytest.raises(ParameterSetError, match="made_at") as refused:
        ParameterSet(
            robot_serial="F-1", model="m", nominal_sha256="0" * 64, made_at=text, made_by="b", source="s",
            values=(ParameterValue("a", "m", 1.0),),
        )  # fmt: skip
    assert "+02:00" in refused.value.remedy


def test_what_becomes_due_is_a_day() -> None:
    assert StateDue(what="w", due="2026-01-01").due == "2026-01-01"
    with pytest.raises(ValidationError):
        StateDue(what="w", due="soon")


def test_nothing_else_reads_a_time() -> None:
    found = set()
    for room in ("service", "drivers", "procedures", "calibration", "fake_devices"):
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if "fromisoformat" not in text and "strptime" not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.Attribute) and node.attr in ("fromisoformat", "strptime"):
                    found.add(path.relative_to(ROOT).as_posix())
    assert found <= READERS | OWN, "use service/times.py"
