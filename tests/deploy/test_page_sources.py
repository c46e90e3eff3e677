"""The sources of the pages: no import cycle, and no bare participle as the name of a variable or function."""

import re
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PAGES = Path(__file__).parents[2] / "web" / "src"
IMPORT = re.compile(
    r"""^\s*(?:import|export)\s(?:[^'"();]*?\sfrom\s+)?["'](\.{1,2}/[^'"]+)["']""", re.MULTILINE
)
PARTICIPLES = "told|said|heard|seen|held|kept|given|known|asked|lent|wanted|shown"
DECLARED = re.compile(
    rf"\b(?:const|let|function|snippet)\s+(?:[\[{{][^\]}}=]*\b)?({PARTICIPLES})\b|#({PARTICIPLES})\s*[=:(]"
    rf"|\(({PARTICIPLES})(?:: [^()]*)?\) =>"
)
STOP_BEHIND_A_TEXT = re.compile(r"(?<!\d)\}\.(?:</| \$?\{)")  # a number with its point is none


def imported_files(text: str, folder: Path, known: frozenset[Path]) -> set[Path]:
    """Return the sources that a source imports, types included."""
    found = set()
    for match in IMPORT.finditer(text):
        target = (folder / match[1]).resolve()
        found |= {target, target.with_name(f"{target.name}.ts"), target.with_name(f"{target.name}.svelte")}
    return found & known


def find_cycle(imports: Mapping[Path, set[Path]]) -> list[str]:
    """Return one cycle of imports, empty without one; a component that shows itself inside itself is none."""
    sorter = TopologicalSorter({file: targets - {file} for file, targets in imports.items()})
    try:
        sorter.prepare()
    except CycleError as error:
        return [file.name for file in error.args[1]]
    return []


def page_sources() -> dict[Path, str]:
    files = [file.resolve() for suffix in ("ts", "svelte") for file in PAGES.rglob(f"*.{suffix}")]
    return {file: file.read_text(encoding="utf-8") for file in files}


def test_the_sources_of_the_pages_import_each_other_in_one_direction() -> None:
    sources = page_sources()
    imports = {file: imported_files(text, file.parent, frozenset(sources)) for file, text in sources.items()}
    assert sum(map(len, imports.values())) > 300
    assert not find_cycle(imports)


def test_a_cycle_of_imports_is_found_whatever_is_imported() -> None:
    a, b, c = (PAGES / name for name in ("a.ts", "b.svelte", "c.ts"))
    known = frozenset((a, b, c))
    imports = {
        a: imported_files('import { x } from "./b.svelte";\n', PAGES, known),
        b: imported_files('<script>\n  import type {\n    Y,\n  } from "./c";\n', PAGES, known),
        c: imported_files('export { z } from "./a";\nimport "./c";\n', PAGES, known),
    }
    assert set(find_cycle(imports)) == {"a.ts", "b.svelte", "c.ts"}
    assert not find_cycle(imports | {c: {c}})


@pytest.mark.parametrize("file", sorted(page_sources()), ids=lambda file: file.name)
def test_names_in_the_pages_are_no_bare_participles(file: Path) -> None:
    if file.name != "api_types.ts":
        assert not [match[0] for match in DECLARED.finditer(file.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(
    "line",
    ["let told = 1;", "const [shown, x] = y;", "(told: string) => 1", "#seen: Cell;", "function kept() {"],
)
def test_a_bare_participle_is_found(line: str) -> None:
    assert DECLARED.search(line)


def test_no_page_ends_a_text_with_the_stop_of_one_language() -> None:
    """Chinese has a stop of its own: `sayings.stopped` and `sayings.joined` know it."""
    assert STOP_BEHIND_A_TEXT.search("<strong>{t(title)}.</strong>")
    assert STOP_BEHIND_A_TEXT.search("`${title}. ${description}`")
    assert not [file.name for file, text in page_sources().items() if STOP_BEHIND_A_TEXT.search(text)]
