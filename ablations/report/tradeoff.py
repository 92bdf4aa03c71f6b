"""Makes the page of error over run time as Markdown with diagrams, from records alone."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from ablations.report.tradeoff_kernels import kernel_parts
from ablations.report.tradeoff_quality import TradeoffLimits, quality_parts
from ablations.report.tradeoff_training import training_parts
from ablations.study.sections import relative_link, source_list
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.records import Record


def write_pages(
    page: Path, folder: Path, records: Mapping[str, Sequence[Record]], titles: Mapping[str, str], limits: TradeoffLimits
) -> Iterator[Path]:
    """Write the page and its diagrams; yields each path after writing it.

    Args:
        page: Markdown file.
        folder: of diagrams and records.
        records: by kind: "quality", "training", "numerics"; the page states which of these are missing.
        titles: of the studies of the kind quality.
        limits: limits by which the page chooses settings.

    Raises:
        InputError: a file cannot be written.
    """
    link = relative_link(folder, page)
    parts, diagrams = [HEAD], {}
    makers: dict[str, Callable[[Sequence[Record]], Iterator[tuple[str, str, str]]]] = {
        "quality": partial(quality_parts, titles=titles, limits=limits),
        "training": training_parts,
        "numerics": kernel_parts,
    }
    for kind, make_parts in makers.items():
        if kind not in records:
            parts.append(f"## {KINDS[kind]}\n\nNot measured yet: `gaussian-enhancer tradeoff kind={kind}`.\n")
            continue
        parts.append(f"## {KINDS[kind]}\n")
        for text, name, diagram in make_parts(records[kind]):
            parts.append(text)
            if diagram:
                diagrams[f"{name}.svg"] = diagram
                parts.append(f"![{KINDS[kind]}: {name}]({link}/{name}.svg)\n")
        parts.append(source_list(records[kind], f"{link}/{kind}.jsonl", separator="; or "))
    for name, diagram in diagrams.items():
        write_text(folder / name, diagram)
        yield folder / name
    write_text(page, "\n".join(parts))
    yield page


HEAD = """# Error against run time

After the work-precision diagrams of the ODE community: every method at several settings, one axis the error, the other
the run time, both logarithmic, taken in one run and in turn. Lower left is better. The grey staircase is the Pareto
front, and its settings are ringed: nothing else is at once faster and closer. Made from records by
`gaussian-enhancer tradeoff`.
"""
KINDS = {"quality": "Enhancement", "training": "Training", "numerics": "Numerics"}
