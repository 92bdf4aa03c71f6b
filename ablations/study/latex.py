r"""A rendered table as LaTeX by pandas: booktabs, every character that LaTeX would take as a command made harmless.

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
"""Characters and what prints them."""


def escaped(text: str) -> str:
    """Text that prints as itself; white space is one blank, and what no common font has is named by its code."""
    apart = re.sub("-(?=-)", "-\N{WORD JOINER}", text)  # -- would become a dash
    return " ".join("".join(map(_character, apart)).split())


def document(table: RenderedTable, name: str, caption: str, remarks: Sequence[str], figure: str = "") -> str:
    """The table as a float.

    Args:
        table: its text.
        name: its label.
        caption: plain text.
        remarks: sentences under the table.
        figure: file name of a picture over the table; empty for none.
    """
    notes = [rf"\textsuperscript{{{number}}} {escaped(note)}" for number, note in enumerate(table.notes, 1)]
    under = "\\par\n".join([*(escaped(remark) for remark in remarks), *notes])
    picture = rf"\includegraphics[width=\textwidth]{{{figure}}}\par\medskip" + "\n" if figure else ""
    return rf"""% needs \usepackage{{booktabs,graphicx}}
\begin{{table*}}[t]
\centering
\caption{{{escaped(caption)}}}
\label{{tab:{name.replace("_", "-")}}}
{picture}\resizebox{{\textwidth}}{{!}}{{%
{tabular(table)}}}
\par\smallskip\raggedright\footnotesize
{under}
\end{{table*}}
"""


def tabular(table: RenderedTable) -> str:
    """The tabular alone; a block's heading stands in the first column of its first line."""
    frames = []
    for title, block in table.blocks:
        texts = block.map(_cell)
        if any(title for title, _ in table.blocks):
            texts.insert(0, "block", [escaped(title), *[""] * (len(texts) - 1)])
        frames.append(texts)
    whole = pd.concat(frames, ignore_index=True).rename(columns=escaped)
    numbers = whole.shape[1] - whole.columns.get_loc("method") - 1
    columns = "l" * (whole.shape[1] - numbers) + "r" * numbers
    return str(whole.style.hide(axis="index").to_latex(hrules=True, column_format=columns)).rstrip()


def _cell(cell: Cell) -> str:
    text = rf"\textbf{{{escaped(cell.text)}}}" if cell.best else escaped(cell.text)
    return text + (rf"\textsuperscript{{{','.join(map(str, cell.notes))}}}" if cell.notes else "")


def _character(character: str) -> str:
    if character in SPECIAL:
        return SPECIAL[character]
    if unicodedata.category(character) in ("Cc", "Zl", "Zp", "Zs"):
        return " "
    if ord(character) < 0x180 and unicodedata.category(character) not in ("Cf", "Cs"):
        return character  # ASCII, Latin-1 and Latin Extended-A, which LaTeX's UTF-8 knows
    return f"(U+{ord(character):04X})"
