"""What the paper claims, and whether the records say so too.

Source of the claims: GaussianEnhancer++, Symmetry 17(3), 442, 2025, section 5 (discussion of its tables).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from ablations.study.aims import better
from ablations.study.description import FAITHFUL, TableDescription
from ablations.study.lines import table_lines
from ablations.study.rendered_table import SPLATS
from ablations.study.results import Results
from ablations.study.statistics import interval
from gaussian_enhancer.report.quantities import quantities

VERDICTS = {True: "holds here", False: "does not", None: "undecided"}
RUNS = 3
"""Repeated runs below which a standard deviation says too little to be compared."""


Finding = tuple[bool | None, str]
"""Whether one comparison goes the claimed way, None where it is not known; and its numbers in words."""


@dataclass(frozen=True)
class Claim:
    """A claim and its verdict.

    Args:
        text: what the paper says.
        findings: the comparisons behind it.
    """

    text: str
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """One of `VERDICTS`: one comparison that goes the other way decides, then one that is open."""
        outcomes = [outcome for outcome, _ in self.findings]
        return VERDICTS[False if False in outcomes else None if None in outcomes or not outcomes else True]

    @property
    def counted(self) -> str:
        """How many comparisons go which way."""
        outcomes = [outcome for outcome, _ in self.findings]
        against, open_ = outcomes.count(False), outcomes.count(None)
        return f"{outcomes.count(True)} of {len(outcomes)} as claimed, {against} against, {open_} open"


def claims(tables: Sequence[Results]) -> tuple[Claim, ...]:
    """The paper's claims, judged on its own system alone: the rows whose mode is "paper".

    Args:
        tables: their records.
    """
    by_name = {results.study.name: results for results in tables}
    return (
        Claim(
            "SSIF is ahead of SIF (table 10: GE with SSIF over GE)",
            tuple(_over(by_name, ("table_10",), "ge_ssif", ["ge"])),
        ),
        Claim(
            "SSIF gives more PSNR than TSDS does (table 10: GE with SSIF over GE with TSDS)",
            tuple(_over(by_name, ("table_10",), "ge_ssif", ["ge_tsds"], _psnr)),
        ),
        Claim(
            "TSDS helps SSIM and LPIPS (table 10: GE with TSDS over GE)",
            tuple(_over(by_name, ("table_10",), "ge_tsds", ["ge"], _structure)),
        ),
        Claim(
            "GE++ is ahead of every other method (tables 2, 4, 5 and 10)",
            tuple(_over(by_name, ("table_2", "table_4", "table_5", "table_10"), "gepp")),
        ),
        Claim(
            "GE is ahead of GE++ in PSNR on simple objects (table 6, the splats for which the paper has it so)",
            tuple(_over(by_name, ("table_6",), "ge", ["gepp"], _psnr, as_printed=True)),
        ),
        Claim("Standard deviations over runs are as small as the paper's (tables 7 to 9)", tuple(_deviations(by_name))),
        Claim(
            "SR is ahead of GE++ (LR) and bicubic enlargement (table 1)",
            tuple(_over(by_name, ("table_1",), "gepp_sr", ["gepp_lr_bicubic"])),
        ),
    )


def _over(
    by_name: Mapping[str, Results],
    names: Sequence[str],
    method: str,
    others: Sequence[str] | None = None,
    asked: Callable[[str], bool] | None = None,
    as_printed: bool = False,
) -> Iterator[Finding]:
    """Whether a method is ahead of others in tables.

    Args:
        by_name: the tables' records.
        names: the tables.
        method: the paper's name of the method.
        others: the paper's names of those that it is to be ahead of; None for the baseline and all others of the paper.
        asked: which metrics count; None for all.
        as_printed: leave out the splats where the paper's own numbers do not have it so.
    """
    for name in names:
        if name not in by_name:
            yield None, f"{name} was not made"
            continue
        results = by_name[name]
        own, over = FAITHFUL + method, _others(results.study, method, others)
        lacking = [one for one in (own, *over) if one not in results.study.methods]
        if lacking:
            yield None, f"{name} has no method {lacking[0]}"
            continue
        for block in results.blocks:
            for other in over:
                for metric in filter(asked, results.study.metrics):
                    if not as_printed or _printed(results.study, block, own, other, metric):
                        yield _difference(results, block, own, other, metric)


def _others(table: TableDescription, method: str, others: Sequence[str] | None) -> list[str]:
    """The rows that a method of the paper is held against: of the paper, and the baseline where all are asked for."""
    if others is not None:
        return [FAITHFUL + other for other in others]
    own = [name for name, row in table.methods.items() if row.mode == "paper" and name != FAITHFUL + method]
    return [table.baseline, *own]


def _difference(results: Results, block: str, method: str, other: str, metric: str) -> Finding:
    """One difference with its interval; known where nothing is missing and the interval leaves out zero."""
    gains = results.gains(block, method, metric, other)
    label = quantities({metric})[0].label
    context = f"{results.study.name}, {SPLATS.get(block, block)}, {method} over {other}, {label}"
    if not gains.values:
        return None, f"{context}: missing"
    low, high = interval(gains)
    ends = sorted((better(metric) * low, better(metric) * high))
    outcome = None if not gains.whole else True if ends[0] > 0 else False if ends[1] < 0 else None
    lacking = "" if gains.whole else f", {len(gains.missing)} of {len(gains.missing) + len(gains.values)} cells missing"
    between = "" if math.isnan(low) else f" [{low:+.4f}, {high:+.4f}]"
    return outcome, f"{context} {gains.mean():+.4f}{between}{lacking}"


def _deviations(by_name: Mapping[str, Results]) -> Iterator[Finding]:
    """Our standard deviation against the paper's, dataset by dataset and metric by metric."""
    for name in ("table_7", "table_8", "table_9"):
        if name not in by_name:
            yield None, f"{name} was not made"
            continue
        results = by_name[name]
        table = results.study
        for line in table_lines(results, results.records):
            if line.statistic == "std" and table.methods[line.method].mode == "paper":
                for metric, number in line.numbers.items():
                    context = f"{table.name}, {table.datasets[line.dataset].title}, {quantities({metric})[0].label}"
                    ours, paper = number.gain, number.paper_gain
                    if ours is None or paper is None or number.seeds < RUNS:
                        yield (
                            None,
                            f"{context}: {number.seeds} runs" if paper is not None else f"{context}: none printed",
                        )
                    else:
                        yield ours <= paper, f"{context} {ours:.4f} against {paper:g} ({number.seeds} runs)"


def _printed(table: TableDescription, block: str, method: str, other: str, metric: str) -> bool:
    """Whether the paper's numbers have a method ahead of another; True where it has none."""
    cells = table.paper.get(block, {})
    ours, theirs = cells.get(method), cells.get(other)
    place = table.metrics.index(metric)
    return ours is None or theirs is None or better(metric) * (ours[place] - theirs[place]) > 0


def _psnr(metric: str) -> bool:
    return metric == "psnr"


def _structure(metric: str) -> bool:
    return metric == "ssim" or metric.startswith("lpips")
