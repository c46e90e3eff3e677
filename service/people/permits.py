"""Whether somebody may give an order just now, and in whose name it goes to the desk."""

from collections import OrderedDict
from typing import Any

from service.desk.messages import AnswerIt, Order
from service.people.entrance import Person
from service.people.errors import NotAllowedError, PeopleError, PinAgainError, SecondPersonError
from service.people.roles import Need, Right, Role, need_of

_KEPT = 200


class StaleViewError(PeopleError):
    """The answer is to a question that is not, or no longer, shown."""

    code = "desk.stale"
    status = 409

    def __init__(self) -> None:
        super().__init__("the page was out of date.", remedy="Look at the present step.")


class Permits:
    """What has been approved by a first person, and which answers passed."""

    def __init__(self) -> None:
        self._first: tuple[str, str] = ("", "")  # what is asked, word for word, and who said yes to it first
        self._passed: OrderedDict[str, str] = OrderedDict()

    def granted(
        self, person: Person, press: str, rev: int, order: Order, session: dict[str, Any] | None
    ) -> str:
        """Return the name in which the order may go to the desk.

        A yes is judged by the question that is shown: the desk takes it only for the very ``rev`` that was judged.

        Raises
        ------
        NotAllowedError, PinAgainError
            The role does not include it; the PIN is wanted first.
        SecondPersonError
            It is noted as the first of two approvals.
        StaleViewError
            The question is not the one that is shown.
        """
        if not isinstance(order, AnswerIt) or not person.may(Right.RUN):
            _refuse(person, need_of(order, None))
            return person.name
        same = f"{press}|{rev}|{order.prompt_id}|{order.value}|{person.name}"
        if same in self._passed:
            return self._passed[same]  # sent again after a lost link: the desk knows it, too
        prompt = _prompt(order, rev, session)
        need = need_of(order, prompt)
        _refuse(person, need)
        who = person.name if person.may_by_itself(need) else self._second(person, str(sorted(prompt.items())))
        self._passed[same] = who
        while len(self._passed) > _KEPT:
            self._passed.popitem(last=False)
        return who

    def _second(self, person: Person, asked: str) -> str:
        before, first = self._first
        if before == asked and first != person.name:
            self._first = ("", "")
            return f"{first} and {person.name}"
        self._first = (asked, person.name)
        raise SecondPersonError(person.name)


def _prompt(order: AnswerIt, rev: int, session: dict[str, Any] | None) -> dict[str, Any]:
    prompt = None if session is None or session["rev"] != rev else session["prompt"]
    if prompt is None or prompt["id"] != order.prompt_id:
        raise StaleViewError
    return dict(prompt)


def _refuse(person: Person, need: Need) -> None:
    if person.locked and need.right not in (Right.SEE, Right.STOP):
        raise PinAgainError("this screen was left alone for a while:")
    if not person.may(need.right):
        raise NotAllowedError(person.name, person.role, need.right.value, _who_may(need.right))
    if need.fresh_pin and not person.fresh_pin:
        raise PinAgainError("for an approval")


def _who_may(right: Right) -> str:
    if right is Right.CHANGE_LIMITS:
        return "Let an engineer sign in."
    return f"Let a {Role.TECHNICIAN} or an {Role.ENGINEER} sign in."
