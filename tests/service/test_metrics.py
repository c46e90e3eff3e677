"""What a Prometheus server reads: by a parser from the format's document, which takes nothing that is not in it."""

import asyncio
import errno
import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from cellcal.procedures.run_history import EventKind
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.configuration.cell_file import CellConfig, read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.export.cell_metrics import CONTROLLER_SILENT_S, CellMetrics
from cellcal.service.export.exposition import MetricFamily, render_text
from cellcal.service.people.pin_hashing import pepper_of
from cellcal.service.record.journal import NewEvent
from cellcal.service.record.journal_files import journal_path, lease_folder, open_journal
from cellcal.service.record.robot_lock import acquire_lease
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import user_frame_scene
from tests.service.loopback_site import live_of, session_of
from tests.service.service_client import ServiceClock, open_service_client

_SAMPLE = re.compile(r"([a-zA-Z_:][a-zA-Z0-9_:]*)(?:\{(.*)\})?[ \t]+(\S+)(?:[ \t]+(-?\d+))?")
_LABEL = re.compile(r'([a-zA-Z_][a-zA-Z0-9_]*)="((?:[^"\\\n]|\\[\\n"])*)"(,|$)')
_KINDS = {"counter", "gauge", "histogram", "summary", "untyped"}


@dataclass
class ParsedExposition:
    """An exposition as a server reads it."""

    kinds: dict[str, str] = field(default_factory=dict)
    values: dict[tuple[str, frozenset[tuple[str, str]]], float] = field(default_factory=dict)

    def __call__(self, name: str, **labels: str) -> float:
        return self.values[name, frozenset(labels.items())]

    def labels_of(self, name: str) -> list[dict[str, str]]:
        return [dict(labels) for found, labels in self.values if found == name]


def parse_exposition(text: str) -> ParsedExposition:
    """Read the text format 0.0.4 by its document.

    Each line ends with a newline, TYPE comes once and before the samples of its name, all lines of a name stand
    together, and no sample is there twice.
    """
    assert text == "" or text.endswith("\n")
    read, closed, now, helped = ParsedExposition(), set(), "", set()
    for line in text.split("\n")[:-1]:
        assert line == line.strip()
        assert line
        if line.startswith("# "):
            _, word, name, *rest = line.split(" ", 3)
            assert word in ("HELP", "TYPE")
            assert name not in closed
            if word == "HELP":
                assert name not in helped
                assert re.fullmatch(r"(?:[^\\]|\\\\|\\n)*", rest[0])
                helped.add(name)
            else:
                assert name not in read.kinds
                assert rest[0] in _KINDS
                assert not any(found == name for found, _ in read.values)
                read.kinds[name] = rest[0]
        else:
            match = _SAMPLE.fullmatch(line)
            assert match, line
            name = match[1]
            key = (name, frozenset(_parse_labels(match[2] or "").items()))
            assert key not in read.values, line
            read.values[key] = _parse_number(match[3])
            assert read.kinds.get(name) != "counter" or read.values[key] >= 0
        if name != now:
            closed.add(now)
            assert name not in closed, f"the lines of {name} do not stand together"
            now = name
    return read


def _parse_labels(text: str) -> dict[str, str]:
    found, at = {}, 0
    while at < len(text):
        match = _LABEL.match(text, at)
        assert match, text
        assert match[1] not in found
        found[match[1]] = re.sub(r"\\(.)", lambda one: "\n" if one[1] == "n" else one[1], match[2])
        at = match.end()
    return found


def _parse_number(text: str) -> float:
    assert text in ("NaN", "+Inf", "-Inf") or re.fullmatch(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?", text), text
    return float(text.replace("Inf", "inf"))


HOSTILE = 'a"b\\c\nd{e="f"} 1 # TYPE x counter \\n \\"'


def test_the_parser_gets_back_whatever_was_written() -> None:
    figures = (0.1, -1e-300, 1e308, math.inf, -math.inf, 5e-324, 0.30000000000000004)
    family = MetricFamily("a_name", "gauge", "A help\nwith \\ and a newline.")
    for k, value in enumerate(figures):
        family.add_sample(value, {"text": HOSTILE * k, "k": str(k)})
    read = parse_exposition(
        render_text(
            [
                family,
                MetricFamily("empty", "gauge", "Nothing."),
                MetricFamily("n_total", "counter", "N.").add_sample(3),
            ]
        )
    )
    for k, value in enumerate(figures):
        assert read("a_name", text=HOSTILE * k, k=str(k)) == value
    assert math.isnan(
        parse_exposition(render_text([MetricFamily("x", "gauge", "X.").add_sample(math.nan)]))("x")
    )
    assert set(read.kinds) == {"a_name", "n_total"}
    for name, kind in (("a b", "gauge"), ("1a", "gauge"), ("n", "counter"), ("n_total", "gauge")):
        with pytest.raises(ValueError, match="is no name"):
            MetricFamily(name, kind, "?")


BROKEN = ["a 1", "a  \n", "a{b=c} 1\n", 'a{b="c} 1\n', "# TYPE a thing\n", "a 1\nb 1\na 2\n", "a inf\n"]


@pytest.mark.parametrize("broken", BROKEN)
def test_the_parser_takes_nothing_else(broken: str) -> None:
    with pytest.raises(AssertionError):
        parse_exposition(broken)


def read_of(config: CellConfig, clock: ServiceClock | None = None, **cell_states: dict) -> ParsedExposition:
    meter = CellMetrics(config, clock=clock or ServiceClock())
    for kind, content in cell_states.items():
        meter.on_event(kind, content)
    return parse_exposition(meter.render_metrics())


def test_a_cell_that_stands_well_and_one_that_does_not(tmp_path: Path) -> None:
    config, clock = cell_config(tmp_path), ServiceClock()
    meter = CellMetrics(config, clock=clock)
    silent = parse_exposition(meter.render_metrics())
    assert (silent("cellcal_desk_up"), silent("cellcal_cell_up"), silent("cellcal_journal_events_total")) == (
        0,
        0,
        0,
    )
    meter.on_event("session", session_of("cell-7"))
    meter.on_event("live", live_of())
    well = parse_exposition(meter.render_metrics())
    assert well("cellcal_desk_up") == well("cellcal_cell_up") == 1
    assert well("cellcal_device_ready", device="wire", role="gauge") == 1
    assert well("cellcal_device_value_age_seconds", device="wire", role="gauge") == 0.01
    assert well("cellcal_alarms", code="any") == 0
    meter.on_event("live", live_of(state="stopped"))
    stopped = parse_exposition(meter.render_metrics())
    assert stopped("cellcal_device_ready", device="fanuc", role="robot") == 0
    assert stopped("cellcal_device_state", device="fanuc", role="robot", state="stopped") == 1
    assert stopped("cellcal_alarms", code="device.stopped") == 1
    run = {"state": "running", "outcome": None, "procedure": "x"}
    meter.on_event("session", session_of("cell-7", run=run, prompt={"key": "k"}))
    busy = parse_exposition(meter.render_metrics())
    assert busy("cellcal_run_active") == busy("cellcal_waits_for_person") == 1
    clock.pass_by(CONTROLLER_SILENT_S + 0.1)
    gone = parse_exposition(meter.render_metrics())
    assert gone("cellcal_desk_up") == gone("cellcal_run_active") == 0
    assert gone.labels_of("cellcal_device_ready") == []  # what is not known is not shown as it was


def test_runs_certificates_drift_and_what_is_due(tmp_path: Path) -> None:
    more = (
        '[gauge.certificate]\nnumber = "C"\nlaboratory = "L"\nissued = 2026-02-01\ndue = 2027-02-01\n'
        "expanded_uncertainty_mm = 0.05\n"
    )
    config = cell_config(tmp_path, more=more)
    outcome = asyncio.run(run_in(config, user_frame_scene(), "three_point_frame"))
    issue_certificate(config, outcome.run_id)
    with open_journal(config) as journal:
        header = {"procedure": "drift_check", "cell": {"devices": [{"identity": {"serial": "F-1"}}]}}
        finding = {"look": {"finding": {"change_rms_m": 0.00012, "change_max_m": 0.0003}}}
        ended = {"verdict": "passed", "judgement": {"word": "pass"}, "result": finding}
        journal.append_all("drift-1", [NewEvent(EventKind.STARTED, header), NewEvent(EventKind.ENDED, ended)])
        journal.append_all("drift-2", [NewEvent(EventKind.STARTED, header)])
        events = len(journal.list_events())
    meter = CellMetrics(config)
    read = parse_exposition(meter.render_metrics())
    assert read("cellcal_runs", procedure="three_point_frame", outcome="passed") == 1
    assert read("cellcal_runs", procedure="drift_check", outcome="interrupted") == 1
    with acquire_lease(lease_folder(config), "F-1", "a run (drift-2)"):
        running = parse_exposition(CellMetrics(config).render_metrics())
        assert running("cellcal_runs", procedure="drift_check", outcome="running") == 1
    assert read("cellcal_journal_events_total") == events
    assert read("cellcal_drift_change_rms_meters", robot_serial="F-1") == 0.00012
    assert read("cellcal_drift_change_max_meters", robot_serial="F-1") == 0.0003
    assert {one["procedure"] for one in read.labels_of("cellcal_certificate_timestamp_seconds")} == {
        "three_point_frame", "drift_check",
    }  # fmt: skip
    assert all(
        0 <= v < 3600 for (name, _), v in read.values.items() if name == "cellcal_certificate_age_seconds"
    )
    assert (
        read("cellcal_due_timestamp_seconds", what="calibration of wire") == 1801526400.0
    )  # date -ud 2027-02-02 +%s
    with open_journal(config) as journal:
        journal.append_all("drift-2", [NewEvent(EventKind.ENDED, {"verdict": "refused"})])
    again = parse_exposition(meter.render_metrics())  # read on, not anew
    assert again("cellcal_runs", procedure="drift_check", outcome="refused") == 1
    assert (
        "cellcal_runs",
        frozenset({("procedure", "drift_check"), ("outcome", "interrupted")}),
    ) not in again.values
    assert again("cellcal_journal_events_total") == events + 1
    assert again.kinds["process_cpu_seconds_total"] == "counter"


def test_an_unreadable_journal_is_reported_and_hides_no_other_metric(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    journal_path(config).parent.mkdir()
    journal_path(config).write_text("no database at all")
    read = read_of(config, session=session_of("cell-7"))
    assert (read("cellcal_journal_readable"), read("cellcal_cell_up")) == (0, 1)


def test_an_outbox_that_cannot_be_read_hides_nothing_else(tmp_path: Path) -> None:
    path = cell_config(tmp_path).path
    path.write_text(path.read_text() + '\n[webhook]\nurl = "https://example.com/"\nsecret_file = "secret"\n')
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "webhook_outbox.sqlite").write_text("no database at all")
    read = read_of(read_cell_file(path), session=session_of("cell-7"))
    assert read("cellcal_cell_up") == 1
    assert read.labels_of("cellcal_webhook_waiting") == []


@pytest.mark.parametrize(
    "error", [OSError(errno.EMFILE, "Too many open files"), ImportError("no descriptor")]
)
def test_figures_that_cannot_be_read_are_named_and_hide_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def refuse(_metrics: CellMetrics) -> bool:
        raise error

    monkeypatch.setattr(CellMetrics, "_read_on", refuse)
    read = read_of(cell_config(tmp_path), session=session_of("cell-7"))
    assert read("cellcal_cell_up") == 1
    assert read.labels_of("cellcal_figures_unreadable") == [{"group": "history"}]


async def test_without_descriptors_a_right_token_is_not_called_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> str:
        raise OSError(errno.EMFILE, "Too many open files", str(path))

    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    with path.open("a", encoding="utf-8") as file:
        file.write('\n[metrics]\ntoken_file = "token"\n')
    app = create_app(ServiceSettings(path))
    monkeypatch.setattr("cellcal.service.web.metrics.read_plain_text", refuse)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://127.0.0.1") as browser:
        answer = await browser.get("/metrics", headers={"authorization": "Bearer 0123456789abcdef01234567"})
    assert answer.status_code == 503
    assert "no file descriptors left" in answer.json()["message"]
    assert str(tmp_path) not in answer.text


async def test_reading_metrics_needs_permission(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        answer = await service_client.client.get("/metrics")
        assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
        parse_exposition(answer.text)
        assert (
            await service_client.client.get("/metrics", headers={"host": "evil.example"})
        ).status_code == 421
        elsewhere = httpx.ASGITransport(service_client.app, client=("192.168.0.9", 4))
        async with httpx.AsyncClient(transport=elsewhere, base_url="http://127.0.0.1") as far:
            assert (await far.get("/metrics")).status_code == 403
            assert (await far.get("/api/session")).status_code == 401


async def test_with_a_token_only_its_holder_reads_it_from_here_or_from_afar(tmp_path: Path) -> None:
    token = "0123456789abcdef01234567"
    (tmp_path / "token").write_text(token + "\n")
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    with path.open("a", encoding="utf-8") as file:
        file.write('\n[metrics]\ntoken_file = "token"\n')
    app = create_app(ServiceSettings(path))
    for client in ("127.0.0.1", "192.168.0.9"):
        transport = httpx.ASGITransport(app, client=(client, 4))
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as browser:
            for wrong in (
                "",
                token,
                f"Basic {token}",
                f"Bearer {token[:-1]}",
                "Bearer",
                "Bearer ",
                "Bearer é",
            ):
                headers = {"authorization": wrong.encode()} if wrong else {}
                answer = await browser.get("/metrics", headers=headers)
                assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer"), wrong
            right = await browser.get("/metrics", headers={"authorization": f"Bearer {token}"})
            assert parse_exposition(right.text)("cellcal_desk_up") == 0
    for short in ("", "short", None):
        (tmp_path / "token").unlink() if short is None else (tmp_path / "token").write_text(short)
        async with httpx.AsyncClient(
            transport=httpx.ASGITransport(app), base_url="http://127.0.0.1"
        ) as browser:
            answer = await browser.get("/metrics", headers={"authorization": f"Bearer {short or ''}"})
            assert answer.status_code == 401, "a token that can be guessed admits no request"


async def test_no_secret_and_no_name_of_a_person_is_in_it(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        config = read_cell_file(service_client.app.state.context.settings.cell_file)
        service_client.app.state.meter.on_event("session", session_of("cell-7", controlled_by="Tom"))
        text = (await service_client.client.get("/metrics")).text
        assert pepper_of(config.cell.data_dir).hex() not in text
        assert not any(name in text for name in ("Tom", "Emil", "Ada"))
