"""In which role people begin, answer and sign: in the run's journal before what they say, and when it changes."""

import asyncio

from cellcal.procedures.run_history import EventKind
from cellcal.service.cell_process.messages import AnswerPrompt, ResumeRun, SessionCommand, SignOff, StartRun
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.record.journal_files import open_journal


class SignerRoles:
    """People's roles as the journals of this process's runs contain them."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self._noted: dict[tuple[str, str], list[dict[str, str]]] = {}
        self._beginning: dict[str, list[dict[str, str]]] = {}  # whose order has no run yet

    async def note_signers(self, run_id: str, command: SessionCommand) -> None:
        """Note who is behind an answer and in which role; nothing where that is unknown, or known to the journal."""
        people = [signer.model_dump() for signer in command.people]
        if isinstance(command.order, StartRun | ResumeRun):
            self._beginning = {command.who: people}
        if not isinstance(command.order, AnswerPrompt | SignOff):
            return
        signer_key = run_id, command.who
        if not run_id or not people or self._noted.get(signer_key) == people:
            return
        await asyncio.to_thread(self._journal_roles, run_id, {"who": command.who, "people": people})
        self._noted[signer_key] = people

    def note_beginning(self, run_id: str, who: str) -> None:
        """Note who is behind the order that a run began with, now that there is one."""
        people = self._beginning.pop(who, [])
        if people and self._noted.get((run_id, who)) != people:
            self._journal_roles(run_id, {"who": who, "people": people})
            self._noted[run_id, who] = people

    def _journal_roles(self, run_id: str, body: dict[str, object]) -> None:
        with open_journal(self._config) as journal:
            journal.append(run_id, EventKind.ANSWERS_AS, body, actor=str(body["who"]))
