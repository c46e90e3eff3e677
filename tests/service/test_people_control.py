"""One screen orders, the others look on: who gets control, and how it passes on."""

from pathlib import Path

import pytest

from cellcal.service.cell_process.hold_to_move import DEAD_MAN_S, HoldButton
from cellcal.service.people.errors import ElsewhereError
from cellcal.service.people.session_control import (
    HOLDER_GONE_GRANTED_S,
    REQUEST_GRANTED_S,
    SessionControl,
    SessionHolder,
)
from cellcal.service.web.websocket import HeartbeatNumbers
from tests.service.service_client import ServiceClient, ServiceClock, another_browser, open_service_client

TOM, TINA, EMIL = SessionHolder("1", "Tom"), SessionHolder("2", "Tina"), SessionHolder("3", "Emil")
PAUSE, STOP = {"op": "pause"}, {"op": "stop"}


def test_the_first_to_order_has_control_until_handing_it_over() -> None:
    control = SessionControl(ServiceClock())
    control.take_control(TOM)
    control.take_control(TOM)
    with pytest.raises(ElsewhereError, match="Tom"):
        control.take_control(TINA)
    control.answer_request(TINA.id, give=True)  # there is no request, and Tina has nothing to give
    control.request_control(TINA)
    control.answer_request(TINA.id, give=True)
    assert control.current_holder == TOM
    control.answer_request(TOM.id, give=True)
    assert control.current_holder == TINA
    assert control.to_json(TINA.id) == {
        "mine": True, "holder": "Tina", "asking": None, "asking_mine": False, "remaining_s": None
    }  # fmt: skip


def test_an_unanswered_request_is_granted_to_a_requester_who_still_asks() -> None:
    clock = ServiceClock()
    control = SessionControl(clock)
    control.take_control(TOM)
    control.request_control(TINA)
    clock.pass_by(REQUEST_GRANTED_S - 1.0)
    control.request_control(TINA)
    assert control.current_holder == TOM
    assert control.to_json(TOM.id)["remaining_s"] == 1.0
    with pytest.raises(ElsewhereError, match="Tina"):
        control.request_control(EMIL)
    clock.pass_by(1.0)
    control.request_control(TINA)
    assert control.current_holder == TINA
    control.request_control(EMIL)
    clock.pass_by(2.0 * REQUEST_GRANTED_S)  # Emil's tablet was put away
    control.drop_inactive(lambda _: True)
    assert control.to_json(EMIL.id)["asking"] is None
    control.request_control(EMIL)
    assert control.current_holder == TINA


def test_a_holder_without_an_open_page_is_waited_for_only_as_long_as_a_reload_takes() -> None:
    clock, open_pages = ServiceClock(), {TOM.id, TINA.id}
    control = SessionControl(clock, has_open_page=open_pages.__contains__)
    control.take_control(TOM)
    open_pages.discard(TOM.id)  # the tablet fell, or its browser was closed
    control.request_control(TINA)
    assert control.to_json(TINA.id)["remaining_s"] == HOLDER_GONE_GRANTED_S
    clock.pass_by(HOLDER_GONE_GRANTED_S - 1.0)
    open_pages.add(TOM.id)  # it was a reload: Tom may answer for as long as ever
    assert control.to_json(TINA.id)["remaining_s"] == REQUEST_GRANTED_S - HOLDER_GONE_GRANTED_S + 1.0
    open_pages.discard(TOM.id)
    clock.pass_by(1.0)
    control.request_control(TINA)
    assert control.current_holder == TINA


def test_a_person_goes_on_at_another_screen_at_once_and_answers_there() -> None:
    control = SessionControl(ServiceClock())
    other_screen = SessionHolder("4", TOM.name)
    control.take_control(TOM)
    control.request_control(TINA)
    with pytest.raises(ElsewhereError, match="Tom"):
        control.take_control(
            other_screen
        )  # an order alone takes nothing from a screen that may hold a button
    control.request_control(other_screen)
    assert (control.current_holder, control.takeover_requester) == (other_screen, TINA)
    control.answer_request(TOM.id, give=False)  # that screen looks on now
    control.answer_request(other_screen.id, give=True)
    assert control.current_holder == TINA


def test_a_request_can_be_refused_or_taken_back() -> None:
    control = SessionControl(ServiceClock())
    control.take_control(TOM)
    control.request_control(TINA)
    control.answer_request(TOM.id, give=False)
    assert (control.current_holder, control.to_json(TINA.id)["asking_mine"]) == (TOM, False)
    control.request_control(TINA)
    control.withdraw_request(EMIL.id)
    assert control.to_json(TINA.id)["asking_mine"]
    control.withdraw_request(TINA.id)
    assert not control.to_json(TINA.id)["asking_mine"]


def test_control_ends_when_permission_to_order_ends() -> None:
    control = SessionControl(ServiceClock())
    control.take_control(TOM)
    control.request_control(TINA)
    control.drop_inactive(lambda seat: seat != TOM.id)
    control.take_control(EMIL)
    assert control.current_holder == EMIL
    control.drop_inactive(lambda seat: seat != TINA.id)
    assert control.to_json(EMIL.id)["asking"] is None
    control.release_control(EMIL.id)
    assert control.current_holder is None


def test_a_word_that_lay_in_a_broken_link_moves_nothing() -> None:
    clock = ServiceClock()
    beats = HeartbeatNumbers(clock)
    assert beats.age_s(0) == float("inf")
    first = beats.next_number()
    assert beats.age_s(first) == 0.0
    clock.pass_by(3.0)
    assert beats.age_s(first) == 3.0
    assert beats.age_s(beats.next_number()) == 0.0
    assert beats.age_s(99) == float("inf")


def test_a_word_that_was_long_on_its_way_holds_the_button_only_for_what_is_left_of_it() -> None:
    clock = ServiceClock()
    hold = HoldButton(lambda: None, clock)
    hold.update_state(is_held=True, age_s=0.3)
    assert hold.is_held
    clock.pass_by(DEAD_MAN_S - 0.25)
    assert not hold.is_held
    hold.update_state(is_held=True, age_s=DEAD_MAN_S + 0.01)  # late words do not press
    assert not hold.is_held
    hold.update_state(is_held=True)
    hold.update_state(is_held=True, age_s=0.3)  # and an older one takes nothing from a newer one
    clock.pass_by(0.2)
    assert hold.is_held
    hold.update_state(is_held=False)
    assert not hold.is_held


async def sign_in_two(service_client: ServiceClient, first: str, second: str) -> ServiceClient:
    """Sign two people in, each at a browser of their own; return the second's view."""
    await service_client.from_console()
    await service_client.sign_in(first)
    other = ServiceClient(service_client.app, another_browser(service_client.app), service_client.clock)
    await other.from_console()
    await other.sign_in(second)
    return other


async def test_only_one_of_two_screens_orders_and_both_may_stop(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as tom:
        tina = await sign_in_two(tom, "Tom", "Tina")
        assert (await tom.send_order(PAUSE)).json()["code"] == "desk.gone"  # it went on to the cell process
        refused = await tina.send_order(PAUSE)
        assert (refused.status_code, refused.json()["code"]) == (409, "people.elsewhere")
        assert "Tom" in refused.json()["message"]
        for service_client in (tom, tina):
            assert (await service_client.send_order(STOP)).json()["code"] == "desk.stop_unconfirmed"
        assert (await tina.post_json("/api/control", {"do": "ask"})).json()["asking_mine"]
        assert (await tina.post_json("/api/control", {"do": "give"})).json()["holder"] == "Tom"
        assert (await tom.post_json("/api/control", {"do": "refuse"})).json()["mine"]
        await tina.post_json("/api/control", {"do": "ask"})
        tom.app.state.context.control.clock = lambda: float("inf")
        assert (await tina.post_json("/api/control", {"do": "ask"})).json()[
            "mine"
        ] is False  # it is long forgotten


async def test_control_is_free_when_its_holder_leaves_idles_or_is_removed(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as tom:
        tina = await sign_in_two(tom, "Tom", "Tina")
        for leaves in ("signs out", "idles", "is removed"):
            assert (await tom.send_order(PAUSE)).json()["code"] == "desk.gone"
            assert (await tina.send_order(PAUSE)).json()["code"] == "people.elsewhere"
            if leaves == "signs out":
                await tom.post_json("/api/sign-in/leave", {})
            elif leaves == "idles":
                tom.clock.pass_by(301.0)
                await tina.post_json("/api/sign-in/confirm", {"secret": "141421"})
            else:
                tom.authenticator.accounts.remove_person("Tom", "test")
            assert (await tina.send_order(PAUSE)).json()["code"] == "desk.gone", leaves
            await tina.post_json("/api/sign-in/leave", {})
            await tina.sign_in("Tina")
            await tom.sign_in("Tom")


@pytest.mark.parametrize("name", ["Vera", "Ada"])
async def test_a_viewer_gets_no_control(tmp_path: Path, name: str) -> None:
    async with open_service_client(tmp_path) as service_client:
        other = await sign_in_two(service_client, "Tom", name)
        await service_client.send_order(PAUSE)
        for asks in (other, service_client):
            answer = await asks.post_json("/api/control", {"do": "ask"})
            assert answer.status_code == (403 if asks is other else 200)
        service_client.clock.pass_by(301.0)
        assert (await service_client.post_json("/api/control", {"do": "ask"})).json()["code"] == "people.pin"


async def test_the_second_person_approves_at_the_own_screen_or_at_the_first_s(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as tom:
        tina = await sign_in_two(tom, "Tom", "Tina")
        yes = tom.show_question("accept_mastering")
        assert (await tina.send_order(yes, press="early")).json()["code"] == "people.second_person"
        assert (await tom.send_order(yes, press="2")).json()[
            "code"
        ] == "desk.gone"  # Tina has control; Tom approves
        yes = tom.show_question("accept_mastering", rev=2, prompt_id="run:2")
        press = {"id": "3", "rev": 2, "order": yes}
        second = {"pressed": press, "name": "Tom", "secret": "314159"}
        assert (await tina.post_json("/api/commands/second", second)).json()["code"] == "desk.stale"
        assert (await tina.send_order(yes, rev=2, press="3")).json()["code"] == "people.second_person"
        wrong = await tina.post_json("/api/commands/second", second | {"secret": "111222"})
        assert wrong.json()["code"] == "people.wrong"
        same = await tina.post_json("/api/commands/second", second | {"name": "Tina", "secret": "141421"})
        assert same.json()["code"] == "desk.stale"
        viewer = await tina.post_json("/api/commands/second", second | {"name": "Vera", "secret": "271828"})
        assert viewer.json()["code"] == "people.role"
        assert (await tina.post_json("/api/commands/second", second)).json()["code"] == "desk.gone"


async def test_a_wait_says_how_long(tmp_path: Path) -> None:
    async with open_service_client(tmp_path) as service_client:
        await service_client.from_console()
        for _ in range(5):
            assert (await service_client.sign_in("Tom", "000999")).status_code == 403
        refused = await service_client.sign_in("Tom")
        assert refused.status_code == 429
        assert int(refused.headers["retry-after"]) == 3600
