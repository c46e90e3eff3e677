"""The bus over real sockets with mutual TLS: nothing is lost, nothing foreign arrives, nothing commands a cell."""

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zenoh

from cellcal.calibration.errors import CellError
from cellcal.service.cli.app import run_command_line
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.signing import CheckFinding, station_key
from cellcal.service.site.access import MOST_JOINTS_HZ
from cellcal.service.site.authority import new_authority, read_authority
from cellcal.service.site.keys import MONITOR_NAME
from cellcal.service.site.link_files import MONITOR_FILE, read_link_folder
from cellcal.service.site.listener import FleetListener
from cellcal.service.site.outbox import SiteOutbox
from cellcal.service.site.signed_messages import MessageSigner
from cellcal.service.web.app import create_app
from cellcal.service.web.context import ServiceSettings
from tests.service.loopback_site import (
    PATIENCE_S,
    LoopbackSite,
    SiteListener,
    live_of,
    open_bus,
    session_of,
    wait_until,
)

RUN = "drift_check-0123456789ab"


def cell_view(listener: FleetListener, cell: str):
    return next(one for one in listener.fleet.cell_views(time.monotonic()) if one.cell == cell)


def test_a_cell_is_seen_with_its_state_alarms_joints_and_events(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    with (
        site.start_router(),
        FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener,
    ):
        assert cell_view(listener, "cell-07").link == "never"
        with site.publish_cell("cell-07") as say:

            def is_attended() -> bool:
                say("session", session_of("cell-07"))  # as a cell process does, again and again
                say("live", live_of())
                return (
                    cell_view(listener, "cell-07").link == "online"
                    and cell_view(listener, "cell-07").attended
                )

            wait_until(is_attended)
            joints = wait_until(lambda: listener.fleet.newest_value(site.station_keys("cell-07").joints_key))
            assert joints.body["joints_rad"] == [0.1] * 6
            wire = wait_until(
                lambda: listener.fleet.newest_value(site.station_keys("cell-07").device_key("wire", "value"))
            )
            assert wire.body["length_m"] == 1.25
            site.append_to_journal("cell-07", RUN, 5)
            say("live", live_of(state="stopped"))
            wait_until(lambda: cell_view(listener, "cell-07").alarms)
            assert cell_view(listener, "cell-07").alarms[0]["text"] == "E-stop."
            wait_until(lambda: len(listener.event_numbers("cell-07")) == 6)
            say("gone", {})
            wait_until(
                lambda: (
                    len(cell_view(listener, "cell-07").alarms) == 2
                    and not cell_view(listener, "cell-07").attended
                )
            )
            texts = [alarm["text"] for alarm in cell_view(listener, "cell-07").alarms]
            assert texts == [
                "E-stop.",
                "nothing is heard of its cell process",
            ]  # the end of the stop was not reported
        wait_until(lambda: cell_view(listener, "cell-07").link == "offline")
        assert listener.fleet.flaw_count == 0, list(listener.fleet.flaws)


def test_a_router_that_is_killed_costs_no_event(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    with site.publish_cell("cell-07"):
        site.append_to_journal("cell-07", RUN, 5)
        with site.start_router() as router:
            listener = FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S)
            with listener:
                site.append_to_journal("cell-07", RUN, 10, first=5)
                wait_until(lambda: listener.event_numbers("cell-07") == list(range(1, 16)))
                router.kill()
                router.wait()
                site.append_to_journal("cell-07", RUN, 20, first=15)
                wait_until(lambda: cell_view(listener, "cell-07").link != "online")
                with site.start_router():
                    site.append_to_journal("cell-07", RUN, 5, first=35)
                    wait_until(lambda: listener.event_numbers("cell-07") == list(range(1, 41)))
                assert listener.fleet.flaw_count == 0, list(listener.fleet.flaws)


def test_after_hours_without_a_link_the_site_asks_for_what_it_misses(tmp_path: Path, capsys) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    site.append_to_journal(
        "cell-07", RUN, 520
    )  # more than a page, and nothing of it is in any publisher's memory
    with site.publish_cell("cell-07"):
        wait_until((site.cells["cell-07"].cell.data_dir / "site_outbox.sqlite").exists)
    with (
        site.start_router(),
        site.publish_cell("cell-07"),
        FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener,
    ):
        wait_until(lambda: listener.event_numbers("cell-07") == list(range(1, 521)))
        assert cell_view(listener, "cell-07").events.missing_count == 0
        newest = listener.stored_events("cell-07", 1)[0]["body"]
        assert newest["journal_seq"] == 520
        runs = listener.ask_cell("cell-07", "runs")
        assert runs[0].body == {"runs": []}  # findings alone are no run
        answer = listener.ask_cell("cell-07", "run", id=RUN, after=510)
        assert [message.body["journal_seq"] for message in answer] == list(range(511, 521))
        with pytest.raises(CellError, match="there is no verb 'move'"):
            listener.ask_cell("cell-07", "move")
        with pytest.raises(CellError, match="no certificate"):
            listener.fetch_certificate("cell-07", RUN)
        certificate_path = site.cells["cell-07"].cell.data_dir / "certificates" / f"{RUN}.json"
        certificate_path.parent.mkdir()
        for folder, finding in (
            (certificate_path.parent.parent, CheckFinding.INTACT),
            (tmp_path, CheckFinding.UNKNOWN_KEY),
        ):
            certificate_path.write_text(station_key(folder).sign_document("cellcal certificate 1", {"a": 1}))
            raw, checked = listener.fetch_certificate("cell-07", RUN)
            assert (raw, checked.finding) == (certificate_path.read_bytes(), finding)
        capsys.readouterr()
        arguments = ["monitor", str(site.folder), "--store", str(tmp_path / "other")]
        assert run_command_line([*arguments, "--certificate", f"cell-07/{RUN}"]) == ExitCode.SIGNATURE
        assert capsys.readouterr().out == ""  # what another key signed is not handed on
        assert run_command_line([*arguments, "--wait-s", "2"]) == 0
        assert "cell-07" in capsys.readouterr().out


def test_a_monitor_that_comes_again_keeps_what_it_had(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    with site.start_router(), site.publish_cell("cell-07"):
        site.append_to_journal("cell-07", RUN, 8)
        for first in (8, 12):
            with FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener:
                wait_until(lambda count=first: listener.event_numbers("cell-07") == list(range(1, count + 1)))
            site.append_to_journal("cell-07", RUN, 4, first=first)


def test_foreign_puts_reach_no_listener_and_no_cell_hears_anything(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07", "cell-08")
    read_authority(site.folder).issue_certificate("laptop", tmp_path)  # certified, but no rule names it
    seven, eight = site.station_keys("cell-07"), site.station_keys("cell-08")
    with (
        site.start_router(),
        open_bus(site.zenoh_of_monitor()) as monitor,
        open_bus(site.zenoh_of("cell-07")) as thief,
        open_bus(site.zenoh_of("cell-08")) as victim,
        open_bus(_config_with_certificate(site, tmp_path / "laptop")) as laptop,
    ):
        site_ear, laptop_ear = SiteListener(monitor), SiteListener(laptop)
        cell_ear = SiteListener(victim, f"{eight.base_key}/**")
        wait_until(lambda: (thief.put(seven.state_key, "control"), site_ear.has_received("control"))[1])
        wait_until(lambda: (victim.put(eight.state_key, "own voice"), site_ear.has_received("own voice"))[1])
        for who, name in ((thief, "thief"), (monitor, "monitor"), (laptop, "laptop")):
            for key in (
                eight.state_key,
                eight.alarm_key,
                eight.answer_key("move"),
                f"{eight.base_key}/command",
            ):
                who.put(key, f"forged by {name}")
        replies = list(laptop.get(eight.answer_key("runs"), timeout=5.0))
        before = len(site_ear.received_keys)
        wait_until(lambda: (thief.put(seven.state_key, "the last"), site_ear.has_received("the last"))[1])
        # a session hears its own puts: what the monitor itself said did not go through the router
        foreign = [line for line in site_ear.received_keys if "forged" in line and "by monitor" not in line]
        assert foreign == []
        assert [line for line in cell_ear.received_keys if "forged" in line] == []
        assert [line for line in laptop_ear.received_keys if "by laptop" not in line] == []
        assert [reply for reply in replies if reply.ok is not None] == []
        assert before >= 2


def _config_with_certificate(site: LoopbackSite, certificate: Path) -> zenoh.Config:
    link = read_link_folder(site.monitor_folder, MONITOR_FILE)
    tls = "transport/link/tls"
    files = [("private_key", ".key"), ("certificate", ".pem")]
    changes = [
        (f"{tls}/{way}_{what}", f"{certificate}{end}") for way in ("connect", "listen") for what, end in files
    ]
    return link.zenoh_config(changes)


def test_without_a_certificate_or_with_another_authority_no_peer_is_admitted(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    other = tmp_path / "other"
    other.mkdir()
    authority = new_authority("hall-3", other)  # of the same name
    authority.issue_certificate(MONITOR_NAME, other)
    link = read_link_folder(site.monitor_folder, MONITOR_FILE)
    tls = "transport/link/tls"
    without = [(f"{tls}/enable_mtls", False)] + [
        (f"{tls}/{way}_{what}", None)
        for way in ("connect", "listen")
        for what in ("private_key", "certificate")
    ]
    with site.start_router():
        with open_bus(link.zenoh_config()):
            pass  # the control: with the right files the connection is accepted
        for config in (link.zenoh_config(without), _config_with_certificate(site, other / MONITOR_NAME)):
            with pytest.raises(zenoh.ZError):
                zenoh.open(config)
        plain = zenoh.Config()
        for key, value in (
            ("mode", '"client"'),
            ("connect/endpoints", f'["tcp/127.0.0.1:{site.port}"]'),
            ("connect/timeout_ms", "1000"),
            ("scouting/multicast/enabled", "false"),
        ):
            plain.insert_json5(key, value)
        with pytest.raises(zenoh.ZError):
            zenoh.open(plain)


def test_a_message_that_was_changed_or_moved_is_named_and_dropped(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07", "cell-08")
    keys, config = site.station_keys("cell-07"), site.cells["cell-07"]
    with SiteOutbox(config.cell.data_dir) as outbox:
        epoch = outbox.epoch
    sealer = MessageSigner(station_key(config.cell.data_dir), "cell-07", epoch)
    other = MessageSigner(station_key(site.cells["cell-08"].cell.data_dir), "cell-07", epoch)
    body = {"id": "x:y", "active": True, "source": "y", "text": "true", "code": "x", "remedy": ""}
    good = sealer.sign_message(keys.alarm_key, 1, body)
    bad = {
        "the signature does not belong": good.replace(b'"true"', b'"lies"'),
        "another key signed": other.sign_message(keys.alarm_key, 2, body),
        "was put here": sealer.sign_message(keys.session_event(RUN), 3, body),
        "no JSON": b"\xff\xfe",
        "has not the parts": b'{"seq": 1}',
    }
    with (
        site.start_router(),
        FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener,
        open_bus(site.zenoh_of("cell-07")) as stolen,
    ):
        wait_until(lambda: (stolen.put(keys.alarm_key, good), listener.event_numbers("cell-07"))[1])
        for raw in bad.values():
            stolen.put(keys.alarm_key, raw)
        wait_until(lambda: listener.fleet.flaw_count >= len(bad))
        flaw_text = " ".join(flaw["what"] for flaw in listener.fleet.flaws)
        assert all(words in flaw_text for words in bad)
        assert listener.event_numbers("cell-07") == [1]
        assert [alarm["text"] for alarm in cell_view(listener, "cell-07").alarms] == ["true"]


def test_a_cell_that_floods_its_joints_is_heard_as_often_as_others_and_its_events_all(tmp_path: Path) -> None:
    """1000 a second from one cell, ten from another; events of the one that floods go between."""
    site = LoopbackSite(tmp_path, "cell-07", "cell-08")
    many, few, step_s = 3000, 30, 1e-3
    with (
        site.start_router(),
        open_bus(site.zenoh_of_monitor()) as monitor,
        open_bus(site.zenoh_of("cell-07")) as flooding,
        open_bus(site.zenoh_of("cell-08")) as healthy,
    ):
        ear = SiteListener(monitor)
        loud, calm = (
            one.declare_publisher(site.station_keys(cell).joints_key)
            for one, cell in ((flooding, "cell-07"), (healthy, "cell-08"))
        )
        event = flooding.declare_publisher(
            site.station_keys("cell-07").session_event(RUN), congestion_control=zenoh.CongestionControl.BLOCK
        )
        wait_until(lambda: all(each.matching_status.matching for each in (loud, calm, event)))
        began_s = time.monotonic()
        for k in range(many):
            loud.put(f"{k}")
            event.put(f"{k}")
            if k % (many // few) == 0:
                calm.put(f"{k}")
            time.sleep(max(0.0, began_s + (k + 1) * step_s - time.monotonic()))
        took_s = time.monotonic() - began_s

        def received_count(key: str) -> int:
            return sum(line.startswith(key) for line in ear.received_keys)

        wait_until(lambda: received_count(site.station_keys("cell-07").session_event(RUN)) == many)
        wait_until(
            lambda: received_count(site.station_keys("cell-08").joints_key) >= few / 2
        )  # its ten a second come a little unevenly
        of_flood = received_count(site.station_keys("cell-07").joints_key)
        assert 2 <= of_flood <= took_s * MOST_JOINTS_HZ + 2  # so few of so many, however long it took


def test_a_router_takes_in_a_new_cell_while_it_runs(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    with site.start_router(), site.publish_cell("cell-07"):
        site.add_cells("cell-08")
        with (
            FleetListener(site.monitor_folder, tmp_path / "s.sqlite", patience_s=PATIENCE_S) as listener,
            site.publish_cell("cell-08"),
        ):
            wait_until(
                lambda: [one.link for one in listener.fleet.cell_views(time.monotonic())] == ["online"] * 2
            )


async def test_the_service_of_a_cell_tells_its_site_by_itself(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")  # none of its devices is there
    app = create_app(ServiceSettings(site.cells["cell-07"].path))
    with (
        site.start_router(),
        FleetListener(site.monitor_folder, tmp_path / "s", patience_s=PATIENCE_S) as listener,
    ):
        async with app.router.lifespan_context(app):
            await asyncio.to_thread(wait_until, lambda: cell_view(listener, "cell-07").attended)
            await asyncio.to_thread(wait_until, lambda: cell_view(listener, "cell-07").alarms)
            assert cell_view(listener, "cell-07").alarms[0]["code"] == "cell.unreachable"
        await asyncio.to_thread(wait_until, lambda: cell_view(listener, "cell-07").link == "offline")


def test_every_process_of_the_site_ends_when_asked(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    cell_file = site.cells["cell-07"].path
    with site.start_router() as router:
        commands = [
            ["site", "publish", str(cell_file)],
            ["monitor", str(site.folder), "--json", "--wait-s", "99"],
        ]
        processes = [
            subprocess.Popen(
                [sys.executable, "-m", "cellcal", *words],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=os.environ,
            )
            for words in commands
        ]
        wait_until((site.cells["cell-07"].cell.data_dir / "site_outbox.sqlite").exists)
        wait_until(
            (site.monitor_folder / "received.sqlite").exists
        )  # both listen to signals before they open their files
        for process, number in zip(
            (*processes, router), (signal.SIGINT, signal.SIGTERM, signal.SIGINT), strict=True
        ):
            process.send_signal(number)
        for process in processes:
            assert process.communicate(timeout=PATIENCE_S)[1] is not None
            assert process.returncode == 0
        assert router.wait(PATIENCE_S) == 0


SIGNALLED_IN_A_THREAD = """
import signal, sys, threading, time
from pathlib import Path
from cellcal.service.cli.site import interrupt_event
from cellcal.service.site.router import host_router

listens = threading.Event()

def signal_this_thread():
    listens.wait()
    while "router of the site" not in {thread.name for thread in threading.enumerate()}:
        time.sleep(0.01)
    time.sleep(0.5)  # the main thread waits now
    signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

threading.Thread(target=signal_this_thread, daemon=True).start()
with interrupt_event() as leave:
    host_router(Path(sys.argv[1]), leave, lambda text: listens.set())
"""


def test_a_router_ends_by_a_signal_that_another_thread_takes(tmp_path: Path) -> None:
    site = LoopbackSite(tmp_path, "cell-07")
    process = subprocess.Popen([sys.executable, "-c", SIGNALLED_IN_A_THREAD, str(site.folder / "router")])
    try:
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()
