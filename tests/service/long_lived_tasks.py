"""Where the source begins something that goes on beside its caller, and a way to make any of it raise."""

import ast
import asyncio
import ctypes
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from cellcal.drivers.supervision import SUPERVISOR

ROOT = Path(__file__).parents[2]
ROOMS = ("service", "drivers", "fake_devices", "procedures", "calibration")
SUPERVISION = {"drivers/supervision.py", "fake_devices/keep_running.py"}
BEGINNING = frozenset(
    {
        "create_task", "ensure_future", "Thread", "Timer", "Process", "Popen", "create_subprocess_exec",
        "create_subprocess_shell", "ThreadPoolExecutor", "ProcessPoolExecutor", "run_in_executor", "create_server",
        "serve_forever",
    }
)  # fmt: skip
SUPERVISED = frozenset(
    {"supervise", "start_task", "start_thread", "start_link_thread", "start_link_task", "keep_running"}
)


def started_tasks() -> Iterator[tuple[str, str, str]]:
    """Yield file, function and call of everything that begins a task, a thread or a process."""
    for path in files_naming(BEGINNING, source_files()):
        name = path.relative_to(ROOT).as_posix()
        for function, call in calls_in(path):
            if called_name(call) in BEGINNING:
                yield name, function, called_name(call)


def supervised_names() -> set[str]:
    """Return the names of all supervised tasks; "{}" where a name is filled in."""
    return set(_task_names(source_files(), SUPERVISED))


def shown_task_names() -> set[str]:
    """Return the names of tasks and works whose failures pages show; "{}" where a name is filled in."""
    files = [file for file in source_files() if "fake_devices" not in file.parts]
    return set(_task_names(files, SUPERVISED | {"log_failures", "note_failure"}))


def _task_names(files: list[Path], calling: frozenset[str]) -> Iterator[str]:
    for path in files_naming(calling, files):
        constants = dict(named_texts(path))
        for _, call in calls_in(path):
            if called_name(call) in calling and call.args:
                yield name_template(call.args[0], constants)


def source_files() -> list[Path]:
    return sorted(file for room in ROOMS for file in (ROOT / room).rglob("*.py"))


def files_naming(words: Iterable[str], files: Iterable[Path]) -> Iterator[Path]:
    """Yield the files outside the supervision that hold one of the words: no other need be parsed."""
    for path in files:
        text = path.read_text(encoding="utf-8")
        if path.relative_to(ROOT).as_posix() not in SUPERVISION and any(word in text for word in words):
            yield path


def calls_in(path: Path) -> Iterator[tuple[str, ast.Call]]:
    def walk_calls(node: ast.AST, function: str) -> Iterator[tuple[str, ast.Call]]:
        for child in ast.iter_child_nodes(node):
            inside = child.name if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef) else function
            if isinstance(child, ast.Call):
                yield function, child
            yield from walk_calls(child, inside)

    yield from walk_calls(ast.parse(path.read_text(encoding="utf-8")), "")


def called_name(call: ast.Call) -> str:
    at = call.func
    return at.attr if isinstance(at, ast.Attribute) else at.id if isinstance(at, ast.Name) else ""


def named_texts(path: Path) -> Iterator[tuple[str, str]]:
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            for target in node.targets:
                if isinstance(target, ast.Name):
                    yield target.id, str(node.value.value)


def name_template(name: ast.expr, constants: dict[str, str]) -> str:
    if isinstance(name, ast.Constant):
        return str(name.value)
    if isinstance(name, ast.Call) and called_name(name) == "make_message":
        return re.sub(r"\{\w+\}", "{}", name_template(name.args[0], constants))
    if isinstance(name, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in name.values)
    if isinstance(name, ast.Name) and name.id in constants:
        return constants[name.id]
    if isinstance(name, ast.Name) and name.id == "TASK":  # imported from where the task is
        return "devices of the cell"
    return "{}"


class InjectedError(RuntimeError):
    """What the tests raise in a task."""


def raise_in(name: str) -> bool:
    """Raise where a supervised task waits, or in the middle of a thread's work; False where none runs just now."""
    holder = SUPERVISOR.holder_of(name)
    if holder is None:
        return False
    if isinstance(holder, int):
        return bool(
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(holder), ctypes.py_object(InjectedError)
            )
        )
    return raise_in_task(holder)


def raise_in_task(task: "asyncio.Task[object]") -> bool:
    """Raise in a task of this loop at what it waits for; False where it waits for nothing that can raise."""
    waited = getattr(task, "_fut_waiter", None)
    while isinstance(waited, asyncio.Task):
        waited = getattr(waited, "_fut_waiter", None)
    if waited is None or waited.done() or type(waited) is not asyncio.Future:
        return False
    waited.set_exception(InjectedError("injected by a test"))
    return True


def running_like(pattern: str) -> list[str]:
    """Return the supervised tasks whose names fit a template."""
    fits = re.compile(re.escape(pattern).replace(r"\{\}", ".+"))
    return [name for name in SUPERVISOR.task_names() if fits.fullmatch(name)]


def is_back(name: str, failures: int, healthy: Callable[[], object]) -> bool:
    """Whether a task has failed once more than it had, was named, runs again and does its work."""
    failed = SUPERVISOR.failure_counts().get(name, 0) > failures
    return failed and SUPERVISOR.holder_of(name) is not None and bool(healthy())
