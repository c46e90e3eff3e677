"""A certificate as one HTML page: no script, no font, nothing from another host, and it prints on A4."""

import base64
import hashlib
from collections.abc import Iterable
from html import escape

from cellcal.service.certificates.blocks import (
    Block,
    BulletBlock,
    CertificatePage,
    FactBlock,
    ParagraphBlock,
    PictureBlock,
    Section,
    SignatureFields,
    TableBlock,
    TableCell,
)

_STYLE = """
:root { color-scheme: light; --ink: #1b1b1b; --quiet: #555; --line: #cfcfcf; --band: #f3f5f7; --pass: #00613f;
  --fail: #a3240a; --undecided: #7a4a00; --refused: #a3240a; }
* { box-sizing: border-box; }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: #fff; max-width: 56rem;
  margin: 2rem auto; padding: 0 1rem; }
header.top { display: flex; gap: 1.5rem; align-items: flex-start; justify-content: space-between; }
header.top svg { width: 8.5rem; height: 8.5rem; flex: none; }
h1 { font-size: 1.6rem; margin: 0; } h1 + p { font-size: 1.15rem; margin: .2rem 0; }
h2 { font-size: 1.1rem; margin: 1.8rem 0 .5rem; border-bottom: 2px solid var(--line); padding-bottom: .2rem; }
.verdict { border-left: .5rem solid; padding: .6rem 1rem; background: var(--band); margin: 1rem 0; }
.verdict strong { font-size: 1.4rem; display: block; } .verdict span { color: var(--ink); }
.pass { color: var(--pass); } .fail { color: var(--fail); } .undecided { color: var(--undecided); }
.refused { color: var(--refused); } td.word { font-weight: 700; white-space: nowrap; }
.quiet, small, caption, figcaption { color: var(--quiet); } .strong { font-weight: 600; }
small { display: block; font-size: .82rem; font-weight: 400; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; font-size: .9rem; }
caption { caption-side: bottom; text-align: left; padding-top: .3rem; font-size: .85rem; }
th, td { text-align: left; padding: .3rem .7rem .3rem 0; border-bottom: 1px solid var(--line);
  vertical-align: top; overflow-wrap: anywhere; }
td.n, th.n { text-align: right; white-space: nowrap; }
dl { display: grid; grid-template-columns: minmax(8rem, max-content) 1fr; gap: .2rem 1rem; margin: 0; }
dt { color: var(--quiet); } dd { margin: 0; overflow-wrap: anywhere; }
figure { margin: .8rem 0 1.2rem; } figure svg { max-width: 100%; height: auto; }
th { overflow-wrap: normal; }
/* On a telephone the name of a figure has a line of its own: the verdict on it is seen beside its value. */
@media screen and (max-width: 38rem) {
  header.top svg { width: 6rem; height: 6rem; } header.top div { min-width: 0; overflow-wrap: anywhere; }
  table:has(td.word) { display: flex; flex-direction: column; } /* rows as wide as the sheet */
  table:has(td.word) :is(thead, tbody, caption) { display: block; } table:has(td.word) caption { order: 1; }
  table:has(td.word) :is(colgroup, col) { display: none; }
  table:has(td.word) tr { display: grid; grid-template-columns: repeat(3, minmax(0, 3fr)) minmax(0, 4fr);
    column-gap: .4rem; border-bottom: 1px solid var(--line); }
  table:has(td.word) :is(td.word, th:last-child) { hyphens: auto; } table:has(td.word) th { font-size: .85rem; }
  table:has(td.word) :is(th, td) { border: 0; padding: .2rem 0; text-align: left; white-space: normal; }
  table:has(td.word) tr > :first-child { grid-column: 1 / -1; }
  dl { grid-template-columns: minmax(6rem, 30%) 1fr; } dt { overflow-wrap: anywhere; hyphens: auto; }
}
.sign { break-inside: avoid; margin: 1rem 0 1.4rem; }
.sign div { display: flex; gap: 1.5rem; margin-top: 2rem; }
.sign span { flex: 1; border-top: 1px solid var(--ink); font-size: .8rem; color: var(--quiet); }
footer { margin-top: 2rem; border-top: 1px solid var(--line); padding-top: .4rem; font-size: .8rem;
  color: var(--quiet); overflow-wrap: anywhere; }
@page { size: A4; margin: 18mm; }
@media print { body { font-size: 10pt; margin: 0; padding: 0; max-width: none; } tr, figure { break-inside: avoid; }
  h2 { break-after: avoid; } .scroll { overflow: visible; } }
"""
_STYLE_HASH = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
POLICY = f"default-src 'none'; style-src 'sha256-{_STYLE_HASH}'; base-uri 'none'; form-action 'none'"


def as_html(page: CertificatePage) -> str:
    """Return the page."""
    title = f"{page.heading} {page.run_id}"
    body = (
        f'<header class="top"><div><h1>{escape(page.heading)}</h1><p>{escape(page.title)}</p>'
        f'<p class="quiet">{escape(page.status)}</p></div>{_render_picture(page.qr)}</header>'
        f'<div class="verdict {escape(page.word)}"><strong>{escape(page.verdict)}</strong>'
        f"<span>{escape(page.rule)}</span></div>"
        f"<main>{''.join(map(_render_section, page.sections))}</main>"
        f"<footer>{escape(', '.join(page.footer))}. {escape(page.status)}</footer>"
    )
    return (
        f'<!doctype html>\n<html lang="{page.locale}"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>{body}</body></html>\n"
    )


def _render_section(section: Section) -> str:
    return (
        f"<section><h2>{escape(section.title)}</h2>{''.join(map(_render_block, section.blocks))}</section>\n"
    )


def _render_block(block: Block) -> str:
    match block:
        case ParagraphBlock():
            return f'<p class="{block.tone}">{escape(block.text)}</p>'
        case BulletBlock():
            return f"<ul>{''.join(f'<li>{escape(line)}</li>' for line in block.lines)}</ul>"
        case FactBlock():
            rows = (f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in block.rows)
            return f"<dl>{''.join(rows)}</dl>"
        case TableBlock():
            return _render_table(block)
        case PictureBlock():
            return (
                f"<figure>{_render_picture(block)}<figcaption>{escape(block.caption)}</figcaption></figure>"
            )
        case SignatureFields():
            places = "".join(f"<span>{name}</span>" for name in map(escape, block.places))
            return f'<div class="sign">{escape(block.statement)}<div>{places}</div></div>'


def _render_table(table: TableBlock) -> str:
    head = "".join(_render_cell(cell, 'th scope="col"') for cell in table.head)
    rows = "".join(f"<tr>{_render_row(row)}</tr>" for row in table.rows)
    whole = sum(table.shares)  # a name is not broken in two where another column has place to spare
    wide = "".join(f'<col width="{100 * share / whole:.0f}%">' for share in table.shares)
    # a table may be wider than a phone: it must scroll by keys, too
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(table.caption)}"><table>'
        f"<caption>{escape(table.caption)}</caption>{wide}"
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _render_row(cells: Iterable[TableCell]) -> str:
    return "".join(_render_cell(cell, "td") for cell in cells)


def _render_cell(cell: TableCell, opening: str) -> str:
    kind = "n" if cell.number else f"word {cell.word}" if cell.word else ""
    attribute = f' class="{escape(kind)}"' if kind else ""
    below = f"<small>{escape(cell.below)}</small>" if cell.below else ""
    return f"<{opening}{attribute}>{escape(cell.text)}{below}</{opening.split(maxsplit=1)[0]}>"


def _render_picture(picture: PictureBlock) -> str:
    """Return the drawing inside the page, with its text alternative for screen readers."""
    return picture.svg.replace("<svg ", f'<svg role="img" aria-label="{escape(picture.alt)}" ', 1)
