"""The report as one HTML page, with its figures beside it."""

from html import escape
from pathlib import Path

from hil.paper.report import CHOICES, Claim, Section, Table

STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0 } caption { text-align: left; font-weight: bold; padding: .3em 0 }
th, td { border-bottom: 1px solid #ccc; padding: .25em .8em .25em 0; text-align: left; vertical-align: top }
img { max-width: 100% } figcaption { color: #555 } .no { color: #b00; font-weight: bold }
"""


def write_page(folder: Path, sections: list[Section]) -> Path:
    """Write index.html to the folder; return its path."""
    parts = [
        "<h1>Control of Robots Using Disturbance Observer, on the rig</h1>",
        "<p>S. Komada, M. Ishida, T. Hori: what the paper claims, and what the emulated robot does. Every figure is "
        "measured on the running controllers over CAN in virtual time; nothing here is drawn from the paper.</p>",
        _claims([claim for section in sections for claim in section.claims]),
        _table(CHOICES),
        *(_section(section) for section in sections),
    ]
    title = "<title>Control of Robots Using Disturbance Observer, on the rig</title>"
    head = f'<meta charset="utf-8">{title}<style>{STYLE}</style>'
    path = folder / "index.html"
    path.write_text(f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{"".join(parts)}</body></html>\n')
    return path


def _claims(claims: list[Claim]) -> str:
    rows = [(claim.says, claim.where, claim.measured, claim.verdict) for claim in claims]
    return _table(Table("Claims", ("the paper says", "where", "we measure", "holds"), rows))


def _section(section: Section) -> str:
    figures = [
        f'<figure><a href="{escape(name)}.svg"><img src="{escape(name)}.png" alt="{escape(caption)}"></a>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for name, caption in section.figures
    ]
    tables = [_table(table) for table in section.tables]
    heading = f'<h2 id="{escape(section.name)}">{escape(section.title)}</h2>'
    return "".join([heading, f"<p>{escape(section.text)}</p>", *figures, *tables]) + "\n"


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.header)
    rows = "".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>\n" for row in table.rows)
    return f"<table><caption>{escape(table.title)}</caption><tr>{head}</tr>\n{rows}</table>\n"


def _cell(text: str) -> str:
    return f'<td class="no">{text}</td>' if text == "no" else f"<td>{escape(text)}</td>"
