"""Ledgers for tests: in memory, and one whose process dies at a chosen write."""

import json
from collections.abc import Mapping
from typing import Any

from cellcal.procedures.canonical_json import canonical_json
from cellcal.procedures.run_history import EventKind, RunHistory, fold_events


class CrashError(BaseException):
    """The process is gone: nothing of ours catches this and nothing is stored afterwards."""


class MemoryLedger:
    """Keeps what a journal would keep."""

    def __init__(self, facts: list[tuple[str, Any]] | None = None) -> None:
        self.facts = facts if facts is not None else []
        self._keys: set[str] = set()

    def record(self, kind: EventKind, body: Mapping[str, Any], *, key: str = "") -> None:
        assert not key or key not in self._keys
        self._keys.add(key)
        self.facts.append((kind.value, json.loads(canonical_json(body))))

    def past(self) -> RunHistory:
        return fold_events([(EventKind.STARTED.value, {}), *self.facts])

    def event_kinds(self, step: str) -> list[str]:
        return [kind for kind, body in self.facts if body.get("step") == step]


class MortalLedger(MemoryLedger):
    """Dies at the n-th write: before it is stored, or just after."""

    def __init__(self, facts: list[tuple[str, Any]], dies_at: int, *, stored: bool) -> None:
        super().__init__(facts)
        self._writes_left, self._stored = dies_at, stored

    def record(self, kind: EventKind, body: Mapping[str, Any], *, key: str = "") -> None:
        if self._writes_left < 0:
            raise CrashError
        self._writes_left -= 1
        if self._writes_left < 0 and not self._stored:
            raise CrashError
        super().record(kind, body, key=key)
        if self._writes_left < 0:
            raise CrashError
