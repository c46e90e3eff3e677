"""The colours of the pages: one file has them, each of its three themes has all, and words stand out from their ground."""

import re
from itertools import product
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WEB = ROOT / "web"
COLOURS = WEB / "src/colours.css"
SIGN = WEB / "public/icon.svg"  # the mark of the product, the same everywhere
THEMES = ("usual", "dark", "bright")
BLOCK = re.compile(r':root(?:\[data-theme="(\w+)"\])? \{(.*?)\n\}', re.DOTALL)
TOKEN = re.compile(r"(--[\w-]+): (#[0-9a-f]{6,8});")
NAMED = "white|black|red|green|blue|orange|yellow|purple|gr[ae]y|silver|navy|teal|brown|pink"
PAINT = r"(?:color|background[\w-]*|fill|stroke|border[\w-]*|outline[\w-]*|box-shadow|[\w]*Style)"
LITERALS = (
    re.compile(r"#(?:[0-9a-fA-F]{8}|[0-9a-fA-F]{6}|[0-9a-fA-F]{3,4})\b(?![\w/-])"),
    re.compile(r"\b0x[0-9a-fA-F]{6}\b"),
    re.compile(r"\b(?:rgb|rgba|hsl|hsla|oklch|color-mix)\("),
    re.compile(rf"\b{PAINT}\s*[:=]\s*[\"']?[^;\"'{{}}]*\b(?:{NAMED})\b(?!-)"),
)
# What words stand on, and the words that stand on it.
WORDS = [
    *product(("--ink", "--ink-soft", "--brand", "--good", "--warn", "--bad"), ("--paper", "--card")),
    ("--brand-ink", "--brand"),
    ("--muted-ink", "--muted"),
    ("--good", "--good-soft"),
    ("--warn", "--warn-soft"),
    ("--bad", "--bad-soft"),
    ("--ink", "--warn-soft"),
    ("--ink-soft", "--plot-field"),
]
# Marks, lines and bodies that carry a meaning.
MARKS = [
    *product(
        ("--plot-used", "--plot-out", "--plot-odd", "--plot-before", "--plot-limit"),
        ("--card", "--plot-field"),
    ),
    *product(
        ("--axis-x", "--axis-y", "--axis-z", "--view-name", "--view-wire"), ("--view-above", "--view-below")
    ),
    *product(("--pose-to-do", "--pose-next", "--doubt"), ("--view-above", "--view-below")),
    ("--edge", "--card"),
    ("--edge", "--paper"),
    ("--brand", "--track"),
]


def themes() -> dict[str, dict[str, str]]:
    """Return the colours of each theme by their names."""
    found = {
        name or "usual": dict(TOKEN.findall(body))
        for name, body in BLOCK.findall(COLOURS.read_text(encoding="utf-8"))
    }
    assert tuple(found) == THEMES
    return found


def luminance(colour: str) -> float:
    """Return the relative luminance of #rrggbb as WCAG 2.2 defines it."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours as WCAG 2.2 defines it, 1 to 21."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def sources() -> list[Path]:
    files = [path for kind in ("svelte", "ts", "css") for path in (WEB / "src").rglob(f"*.{kind}")]
    files += [*(WEB / "public").rglob("*.svg"), *WEB.glob("*.html")]
    return sorted({*files} - {COLOURS, SIGN})


def literal_colours(text: str) -> list[str]:
    return [found.group() for literal in LITERALS for found in literal.finditer(text)]


def test_no_colour_stands_outside_the_one_file() -> None:
    assert len(sources()) > 150
    found = {
        str(path.relative_to(WEB)): literals
        for path in sources()
        if (literals := literal_colours(path.read_text(encoding="utf-8")))
    }
    assert not found, found


@pytest.mark.parametrize(
    "line",
    ["fill: #0072b2;", "new Color(0xffffff)", "background: rgb(1 2 3 / 50%);", 'stroke="white"', "color: #fff",
     'pen.fillStyle = "black"', "border: 2px solid red;"],
)  # fmt: skip
def test_a_literal_colour_is_recognized(line: str) -> None:
    assert literal_colours(line)


@pytest.mark.parametrize(
    "line",
    ['href="#/measurements"', "{#each a as b}", "white-space: nowrap;", "#redraw()", "fill: var(--good)"],
)
def test_what_is_no_colour_is_let_pass(line: str) -> None:
    assert not literal_colours(line)


def test_each_theme_has_each_colour_and_each_is_used() -> None:
    usual, *others = themes().values()
    for other in others:
        assert set(other) == set(usual)
    text = "".join(path.read_text(encoding="utf-8") for path in sources())
    used_names = set(re.findall(r"(?:var\(|[\"'])(--[\w-]+?)(?=[)\"',])", text))
    steps = {f"--shade-{step}" for step in range(1, 7)}  # asked for by number
    sizes = {"--gap", "--main-key", "--radius", "--device-fonts", "--acts", "--share", "--columns", "--cut"}
    assert set(usual) - used_names - steps == set()
    assert {name for name in used_names if not name.startswith("--shade")} - set(usual) - sizes == set()


@pytest.mark.parametrize("theme", THEMES)
def test_words_and_marks_stand_out(theme: str) -> None:
    colours = themes()[theme]
    weak = [
        (one, ground, round(ratio, 2))
        for pairs, least in ((WORDS, 7.0), (MARKS, 3.0))
        for one, ground in pairs
        if (ratio := contrast(colours[one], colours[ground])) < least
    ]
    assert not weak, weak


def test_bright_has_the_strongest_words_and_dark_the_darkest_ground() -> None:
    found = themes()
    words = {name: contrast(colours["--ink"], colours["--card"]) for name, colours in found.items()}
    assert words["bright"] == pytest.approx(21.0)
    assert max(luminance(found["dark"][ground]) for ground in ("--paper", "--card", "--view-above")) < 0.03
    lines = {name: contrast(colours["--line"], colours["--card"]) for name, colours in found.items()}
    assert lines["bright"] > 3 * lines["usual"]
