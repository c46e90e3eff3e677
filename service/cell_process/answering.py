"""In which role people begin, answer and sign: in the run's journal before what they say, and when it changes."""

import asyncio

from cellcal.procedures.past import Kind
from cellcal.service.cell_process.messages import AnswerIt, Command, Resume, SignOff, Start
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal_files import open_journal


class Answering:
    """What the journals of this desk's runs already know of people's roles."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._noted: dict[tuple[str, str], list[dict[str, str]]] = {}
        self._beginning: dict[str, list[dict[str, str]]] = {}  # whose order has no run yet

    async def note(self, run_id: str, command: Command) -> None:
        """Note who is behind an answer and in which role; nothing where that is unknown, or known to the journal."""
        people = [signer.model_dump() for signer in command.people]
        if isinstance(command.order, Start | Resume):
            self._beginning = {command.who: people}
        if not isinstance(command.order, AnswerIt | SignOff):
            return
        known = run_id, command.who
        if not run_id or not people or self._noted.get(known) == people:
            return
        await asyncio.to_thread(self._keep, run_id, {"who": command.who, "people": people})
        self._noted[known] = people

    def began(self, run_id: str, who: str) -> None:
        """Note who is behind the order that a run began with, now that there is one."""
        people = self._beginning.pop(who, [])
        if people and self._noted.get((run_id, who)) != people:
            self._keep(run_id, {"who": who, "people": people})
            self._noted[run_id, who] = people

    def _keep(self, run_id: str, body: dict[str, object]) -> None:
        with open_journal(self._config) as journal:
            journal.append(run_id, Kind.ANSWERS_AS, body, actor=str(body["who"]))
