r"""Writes a rendered table as LaTeX by pandas, with booktabs and all special characters escaped.

A document needs ``\usepackage{booktabs,graphicx}``; text is UTF-8.
"""

import re
import unicodedata
from collections.abc import Sequence

import pandas as pd

from ablations.study.rendered_table import Cell, RenderedTable

SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "{''}",
    "`": "`{}",  # ?` and !` would become other characters
    "[": "{[}",  # a line that begins with [ would be an option of the \\ before it
    "]": "{]}",
    "*": "{*}",
    "\N{WORD JOINER}": "{}",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "→": r"$\rightarrow$",
    "×": r"$\times$",
    "±": r"$\pm$",
    "−": "$-$",
    "–": "--",
    "—": "---",
    "…": r"\ldots{}",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "\N{NO-BREAK SPACE}": "~",
}
"""The LaTeX code that prints each special character."""


def escape(text: str) -> str:
    """Escape text for LaTeX. White space becomes one blank; characters missing in common fonts become their codes."""
    separated = re.sub("-(?=-)", "-\N{WORD JOINER}", text)  # -- would become a dash
    return " ".join("".join(map(_character, separated)).split())


def latex_float(table: RenderedTable, name: str, caption: str, remarks: Sequence[str], figure: str = "") -> str:
    """The table as a LaTeX float.

    Args:
        table: the rendered table.
        name: the table's name, from which its label is made.
        caption: plain text.
        remarks: sentences under the table.
        figure: file name of a picture above the table; empty for none.
    """
    notes = [rf"\textsuperscript{{{number}}} {escape(note)}" for number, note in enumerate(table.notes, 1)]
    footer = "\\par\n".join([*(escape(remark) for remark in remarks), *notes])
    picture = rf"\includegraphics[width=\textwidth]{{{figure}}}\par\medskip" + "\n" if figure else ""
    return rf"""% needs \usepackage{{booktabs,graphicx}}
\begin{{table*}}[t]
\centering
\caption{{{escape(caption)}}}
\label{{tab:{name.replace("_", "-")}}}
{picture}\resizebox{{\textwidth}}{{!}}{{%
{tabular(table)}}}
\par\smallskip\raggedright\footnotesize
{footer}
\end{{table*}}
"""


def tabular(table: RenderedTable) -> str:
    """The tabular environment alone; a block's heading is in the first column of its first row."""
    frames = []
    for title, block in table.blocks:
        texts = block.map(_cell)
        if any(title for title, _ in table.blocks):
            texts.insert(0, "block", [escape(title), *[""] * (len(texts) - 1)])
        frames.append(texts)
    combined = pd.concat(frames, ignore_index=True).rename(columns=escape)
    number_columns = combined.shape[1] - combined.columns.get_loc("method") - 1
    columns = "l" * (combined.shape[1] - number_columns) + "r" * number_columns
    return str(combined.style.hide(axis="index").to_latex(hrules=True, column_format=columns)).rstrip()


def _cell(cell: Cell) -> str:
    text = rf"\textbf{{{escape(cell.text)}}}" if cell.best else escape(cell.text)
    return text + (rf"\textsuperscript{{{','.join(map(str, cell.notes))}}}" if cell.notes else "")


def _character(character: str) -> str:
    if character in SPECIAL:
        return SPECIAL[character]
    if unicodedata.category(character) in ("Cc", "Zl", "Zp", "Zs"):
        return " "
    if ord(character) < 0x180 and unicodedata.category(character) not in ("Cf", "Cs"):
        return character  # ASCII, Latin-1 and Latin Extended-A, which LaTeX's UTF-8 knows
    return f"(U+{ord(character):04X})"
