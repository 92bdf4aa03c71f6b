r"""A printed table as LaTeX: booktabs, every character that LaTeX would take as a command made harmless.

A document needs ``\usepackage{booktabs,graphicx}``; text is UTF-8.
"""

import re
import unicodedata
from collections.abc import Sequence

from ablations.report.rendered_cells import Piece, Sheet

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


def document(sheet: Sheet, name: str, caption: str, remarks: Sequence[str], figure: str = "") -> str:
    """The table as a float.

    Args:
        sheet: its cells.
        name: its label.
        caption: plain text.
        remarks: sentences under the table.
        figure: file name of a picture over the table; empty for none.
    """
    width = len(sheet.columns)
    lines = [
        r"% needs \usepackage{booktabs,graphicx}",
        r"\begin{table*}[t]",
        r"\centering",
        rf"\caption{{{escaped(caption)}}}",
        rf"\label{{tab:{name.replace('_', '-')}}}",
        *([rf"\includegraphics[width=\textwidth]{{{figure}}}\par\medskip"] if figure else []),
        r"\resizebox{\textwidth}{!}{%",
        rf"\begin{{tabular}}{{l{'r' * (width - 1)}}}",
        r"\toprule",
        _line([Piece(column) for column in sheet.columns]),
    ]
    for block in sheet.blocks:
        lines.append(r"\midrule")
        if block.title:
            lines.append(rf"\multicolumn{{{width}}}{{l}}{{\textit{{{escaped(block.title)}}}}} \\")
        lines += [_line(pieces) for pieces in block.lines]
    notes = [rf"\textsuperscript{{{number}}} {escaped(note)}" for number, note in enumerate(sheet.notes, 1)]
    under = [*(escaped(remark) for remark in remarks), *notes]
    lines += [r"\bottomrule", r"\end{tabular}}", r"\par\smallskip\raggedright\footnotesize"]
    return "\n".join([*lines, "\\par\n".join(under), r"\end{table*}", ""])


def _line(pieces: Sequence[Piece]) -> str:
    return " & ".join(map(_cell, pieces)) + r" \\"


def _cell(piece: Piece) -> str:
    text = rf"\textbf{{{escaped(piece.text)}}}" if piece.best else escaped(piece.text)
    return text + (rf"\textsuperscript{{{','.join(map(str, piece.notes))}}}" if piece.notes else "")


def _character(character: str) -> str:
    if character in SPECIAL:
        return SPECIAL[character]
    if unicodedata.category(character) in ("Cc", "Zl", "Zp", "Zs"):
        return " "
    if ord(character) < 0x180 and unicodedata.category(character) not in ("Cf", "Cs"):
        return character  # ASCII, Latin-1 and Latin Extended-A, which LaTeX's UTF-8 knows
    return f"(U+{ord(character):04X})"
