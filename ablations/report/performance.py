"""Makes the page on performance from records alone: aims, our and published networks, parts of the pipeline."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

from ablations.study.aims import VERDICTS
from ablations.study.markdown import frame, markdown
from ablations.study.plots import Mark, Panel, work_precision
from ablations.study.sections import distinct_values, missing_section, relative_link, source_list
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.metrics.comparison import compare, pair_records
from gaussian_enhancer.metrics.records import MISSING, Record

YARDSTICK, NETWORK, ENHANCEMENT, PIPELINE, COLD, TRIED = (
    "yardstick", "network", "enhancement", "pipeline", "cold", "tried",
)  # fmt: skip
"""Kinds of records."""
GROUPS = ("ours", "published")
COMMAND, IMPORTS = "enhance", "import torch"
"""Processes whose start-up time is measured."""
FAST = ("bfloat16", "bfloat16 weights")
"""Number types of networks that are compared with ours in bfloat16."""
EQUAL_BUDGET = ("nafnet", "edvr", "paper", "sif", "ssif_lr")
"""Rows of the table equal_budget."""
LABELS = {"paper": "ours with the paper's choices"}
"""Printed names of records' variants: here `paper` is our own network, and not the paper's system (`mode=paper`)."""
SHIPPED = ("lr_tiny",)
"""Rows of docs/results/quality.md."""
EQUAL_PAGE = "[equal budget](results/tables/desk/equal_budget.md)"
MAKE = "nox -s bench"
NOTHING = f"Not measured yet: `{MAKE}`.\n"


@dataclass(frozen=True)
class PageRecords:
    """The records that the page is made from.

    Args:
        records: records of the job ``peers``.
        quality: records of the job ``quality`` on the shipped weights.
        equal_budget: records of the table equal_budget, on networks that were trained alike.
    """

    records: tuple[Record, ...] = ()
    quality: tuple[Record, ...] = ()
    equal_budget: tuple[Record, ...] = ()

    FILES: ClassVar[tuple[str, ...]] = ("records", "quality", "equal_budget")

    def of(self, kind: str, name: str = "") -> tuple[Record, ...]:
        """The records of the job ``peers`` of a kind, and of a variant if ``name`` is given."""
        return tuple(record for record in self.records if record.kind == kind and name in ("", record.variant))

    def pipeline(self, name: str, size: tuple[int, int]) -> Record | None:
        """The record of a pipeline by weights, width and height; None if there is none."""
        return next((record for record in self.of(PIPELINE, name) if tuple(record.size) == size), None)


@dataclass(frozen=True)
class Target:
    """An aim of the project.

    Args:
        part: the quantity.
        limit: its limit.
        unit: unit of the limit.
        value: returns the measured value; None if it was not measured.
        bound: returns a text on what bounds the value.
        at_most: whether the limit is an upper one; else it is a lower one.
    """

    part: str
    limit: float
    unit: str
    value: Callable[[PageRecords], float | None]
    bound: Callable[[PageRecords], str]
    at_most: bool = True

    def line(self, sources: PageRecords) -> tuple[str, str, str, str, str]:
        """Part, aim, measured value, verdict and bound, as texts."""
        measured = self.value(sources)
        aim = f"{'at most' if self.at_most else 'at least'} {self.limit:,g} {self.unit}".rstrip()
        if measured is None:
            return self.part, aim, "not measured", "", ""
        met = measured <= self.limit if self.at_most else measured >= self.limit
        return self.part, aim, f"{number(measured)} {self.unit}".rstrip(), VERDICTS[met], self.bound(sources)


def number(value: float) -> str:
    """Format a number with about three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _code_or_label(variant: str) -> str:
    """A network of ours as Markdown: its name as code, or its label."""
    return LABELS.get(variant, f"`{variant}`")


def gains(sources: PageRecords) -> dict[str, float]:
    """Mean gain in PSNR over the render by method, in dB, on the held-out views of its page."""
    gain_by_method = {}
    for records, names, table in ((sources.equal_budget, EQUAL_BUDGET, ""), (sources.quality, SHIPPED, "lr/")):
        measured_variants = {record.variant for record in records if record.kind == "quality"}
        for name in names:
            if {f"{table}{name}", f"{table}raw"} <= measured_variants:
                gain_by_method[name] = compare(pair_records(records, f"{table}raw", f"{table}{name}"), "psnr").gain
    return gain_by_method


def times_ours(sources: PageRecords, name: str) -> float | None:
    """Ratio of a network's time to that of our whole enhancement, in the network's fastest number type."""
    ratios = [record.metrics.get("times_ours") for record in sources.of(NETWORK, name) if record.splat in FAST]
    return min((value for value in ratios if value is not None), default=None)


def parts_of(record: Record) -> dict[str, float]:
    """Milliseconds by part of a pipeline's record."""
    milliseconds = {
        name.removeprefix("part: "): value for name, value in record.metrics.items() if name.startswith("part: ")
    }
    return {name: value for name, value in milliseconds.items() if value is not None}


def slowest_parts(record: Record | None) -> str:
    """The four slowest parts of the pipeline, without reading, with their shares of the time as text."""
    if record is None:
        return ""
    parts = {name: value for name, value in parts_of(record).items() if name != "read"}
    total = sum(parts.values()) or 1.0
    slowest = sorted(parts.items(), key=lambda item: -item[1])[:4]
    return ", ".join(f"{name} {value / total:.0%}" for name, value in slowest)


def _largest(records: Sequence[Record]) -> Record | None:
    return max(records, key=lambda record: record.size, default=None)


def _metric(record: Record | None, name: str) -> float | None:
    return None if record is None else record.metrics.get(name)


def _growth(sources: PageRecords) -> float | None:
    """Ratio of the largest to the smallest time per megapixel, for images of at least a quarter of a megapixel."""
    large = [record for record in sources.of(PIPELINE, "lr_tiny") if record.size[0] * record.size[1] >= 0.25e6]
    times = [value for record in large if (value := record.metrics[TIME]) is not None]
    return max(times) / min(times) if len(times) > 1 else None


def _first(sources: PageRecords, kind: str, name: str, metric: str) -> float | None:
    return next((record.metrics[metric] for record in sources.of(kind, name)), None)


def _pipeline_target(part: str, limit: float, unit: str, name: str, size: tuple[int, int], metric: str) -> Target:
    def record(sources: PageRecords) -> Record | None:
        return sources.pipeline(name, size)

    if metric == "peak_memory_mb":
        return Target(part, limit, unit, lambda s: _metric(record(s), metric), lambda _: "decoded images and features")
    return Target(part, limit, unit, lambda s: _metric(record(s), metric), lambda s: slowest_parts(record(s)))


def _peer_target(name: str, limit: float) -> Target:
    about = "our time holds alignment and all limits to the change, theirs the network alone"
    return Target(
        f"`lr_tiny`, times as fast as {name}", limit, "", lambda s: times_ours(s, name), lambda _: about, at_most=False
    )


def _better_target(name: str) -> Target:
    def value(sources: PageRecords) -> float | None:
        gain_by_method = gains(sources)
        return gain_by_method["ssif_lr"] - gain_by_method[name] if {"ssif_lr", name} <= set(gain_by_method) else None

    part = f"PSNR beyond `{name}` at equal budget"
    return Target(part, 0.0, "dB", value, lambda _: f"fits of 1,000 steps: {EQUAL_PAGE}", at_most=False)


WIDTHS = "widths of the decoders"
VIEW, TINY_VIEW, SR_VIEW = (1008, 756), (320, 240), (1152, 864)
TARGETS = (
    _pipeline_target("`lr_tiny` at 1008x756, decoded images to a file", 220.0, "ms / MP", "lr_tiny", VIEW, TIME),
    _pipeline_target(
        "`lr_tiny` at 320x240, decoded images to a file", 25.0, "ms", "lr_tiny", TINY_VIEW, "decoded_milliseconds"
    ),
    _pipeline_target(
        "`sr_tiny` to 16 megapixels, decoded images to a file", 3000.0, "ms", "sr_tiny", SR_VIEW, "decoded_milliseconds"
    ),
    _pipeline_target("memory above imports, 1 megapixel", 600.0, "MB", "lr_tiny", VIEW, "peak_memory_mb"),
    _pipeline_target("memory above imports, 16 megapixels", 1500.0, "MB", "sr_tiny", SR_VIEW, "peak_memory_mb"),
    Target(
        "start of `enhance` to its first image", 2000.0, "ms", lambda s: _first(s, COLD, COMMAND, "milliseconds"),
        lambda s: f"`import torch` alone takes {number(_first(s, COLD, IMPORTS, 'milliseconds') or 0.0)} ms",
    ),
    Target(
        "largest over least time a megapixel, from 0.25 megapixels on", 1.1, "", _growth,
        lambda s: f"at the largest size: {slowest_parts(_largest(s.of(PIPELINE, 'lr_tiny')))}",
    ),
    _peer_target("NAFNet-w32", 15.0),
    _peer_target("Restormer", 50.0),
    _peer_target("edvr, base", 50.0),
    Target(
        "`lr_tiny`, 10^9 multiply-adds / MP", 20.0, "",
        lambda s: _first(s, NETWORK, "lr_tiny", "giga_multiply_adds_per_megapixel"), lambda _: WIDTHS,
    ),
    _better_target("nafnet"),
    _better_target("edvr"),
)  # fmt: skip
ELSEWHERE = """Not measured by this job: time against the number of references, runs of 100 views with reading,
rendering and writing overlapped, memory over 20 to 500 images, a splat's fit (`gaussian-enhancer splat_kernels`),
graphics cards.
"""
HEAD = """# Performance

Times are medians over rounds in which everything runs in turn, in one process. "Yardsticks" is the median, over the
rounds, of a time divided by that of a fixed convolution in the same round: that ratio, and no time, is what
`tests/ablations/test_peers.py` guards. Made from records by `gaussian-enhancer peers`; `{make}` measures anew, and
`{make} -- device=cuda` on a graphics card, where the device is waited for at both ends of every time.

"""


def performance_page(sources: PageRecords, files: Mapping[str, Path], drawing: Path, page: Path) -> str:
    """The page as Markdown.

    Args:
        sources: records.
        files: their files, by name of the field of `PageRecords`.
        drawing: the diagram's file.
        page: the page's file, for links.
    """

    def section(heading: str, make: Callable[[Sequence[Record]], str], *kinds: str) -> str:
        records = [record for kind in kinds for record in sources.of(kind)]
        return f"\n## {heading}\n\n{make(records) if records else NOTHING}"

    parts = [HEAD.format(make=MAKE)]
    lines = [target.line(sources) for target in TARGETS]
    parts += ["## Aims\n\n", markdown(frame(("part", "aim", "measured", "verdict", "what bounds it"), lines))]
    parts += ["\n", ELSEWHERE, section("Yardsticks", _yardsticks, YARDSTICK)]
    parts += [section("Networks", partial(_networks, sources), NETWORK, ENHANCEMENT)]
    parts += [section("The whole pipeline", _pipelines, PIPELINE)]
    parts += [section("Start of the command line", _cold_table, COLD)]
    parts += ["\n## Quality of the equal-budget peers\n\n", _quality(sources)]
    parts += [f"\n![gain in PSNR against time]({relative_link(drawing, page)})\n"]
    parts += [section("What was tried", _tried, TRIED), "\n## Graphics cards\n\n", _cards(sources)]
    parts += ["\n## Sources\n\n"]
    for name in sources.FILES:
        if source_records := getattr(sources, name):
            parts.append(source_list(source_records, relative_link(files[name], page), separator="; or "))
    return "".join(parts)


def _yardsticks(records: Sequence[Record]) -> str:
    lines = []
    for record in records:
        milliseconds, rate = (number(record.metrics[name] or 0.0) for name in ("milliseconds", "a_second"))
        lines.append((record.variant, milliseconds, f"{rate} {record.view}"))
    return markdown(frame(("workload", "ms", "a second"), lines))


NETWORKS = """Time and multiply-adds are for a megapixel of the image that comes out; the input is {width}x{height}.
"Network" is the forward pass alone, of ours with references on the target's grid already; "whole" is everything from
decoded images on: planning, search of depth, alignment, network, limits to the change. Published networks have random
weights. "Arithmetic" is what the multiply-adds would take at the convolution's rate, "memory" what the operations'
reads and writes would take at the copy's; caches save some of that. "Times ours" is the time of a network divided by
that of our whole enhancement at the same scale, `lr_tiny` or `sr_tiny`, with the interval of the rounds' median.

"""


def _networks(sources: PageRecords, records: Sequence[Record]) -> str:
    rates = {record.variant: record.metrics["a_second"] or 1.0 for record in sources.of(YARDSTICK)}
    headings = ("network", "of", "what", "number type", "scale", "parameters", "10^9 multiply-adds / MP", "ms / MP",
             "arithmetic, ms / MP", "memory, ms / MP", "yardsticks", "times ours", "peak MB")  # fmt: skip
    lines = [_network_line(record, rates) for record in records]
    text = NETWORKS.format(width=records[0].size[0], height=records[0].size[1]) + markdown(frame(headings, lines))
    missing = [
        (f"{_code_or_label(record.variant)}, {record.splat}", record.reasons["row"]) for record in sources.of(MISSING)
    ]
    return f"{text}\n{missing_section(missing)}" if missing else text


def _known(record: Record) -> dict[str, float]:
    """The metrics that were measured."""
    return {name: value for name, value in record.metrics.items() if value is not None}


def _network_line(record: Record, rates: Mapping[str, float]) -> tuple[str, ...]:
    values = _known(record)
    rate = rates["convolution, float32" if record.splat == "float32" else "convolution, bfloat16"]
    return (
        _code_or_label(record.variant) if record.scene == GROUPS[0] else record.variant,
        record.scene,
        "whole" if record.kind == ENHANCEMENT else "network",
        record.splat,
        f"{values['scale']:.0f}x",
        f"{values['parameters']:,.0f}",
        f"{values['giga_multiply_adds_per_megapixel']:,.1f}",
        f"{number(values[TIME])} [{number(values[LOW])}, {number(values[HIGH])}]",
        number(1e3 * values["giga_multiply_adds_per_megapixel"] / rate),
        number(1e3 * values["gigabytes_per_megapixel"] / rates["copy"]),
        number(values["yardsticks"]),
        _with_interval(values, "times_ours"),
        number(values["peak_memory_mb"]) if "peak_memory_mb" in values else "",
    )


def _with_interval(values: Mapping[str, float], name: str) -> str:
    if name not in values:
        return ""
    return f"{number(values[name])} [{number(values[f'{name}_low'])}, {number(values[f'{name}_high'])}]"


PIPELINES = """Views of a procedural scene, in the number type that `precision=auto` takes. "File to file" reads the
render and five candidate photos with their renders and depth, enhances, and writes a PNG; "decoded" leaves reading out.

"""


def _pipelines(records: Sequence[Record]) -> str:
    headings = ("weights", "render", "output MP", "file to file, ms", "decoded, ms", "decoded, ms / MP", "yardsticks",
             "peak MB")  # fmt: skip
    lines = []
    for record in records:
        values = _known(record)
        width, height = record.size
        lines.append((
            f"`{record.variant}`", f"{width}x{height}", f"{width * height * values['scale'] ** 2 / 1e6:.2f}",
            number(values["milliseconds"]), number(values["decoded_milliseconds"]), number(values[TIME]),
            number(values["yardsticks"]), number(values["peak_memory_mb"]) if "peak_memory_mb" in values else "",
        ))  # fmt: skip
    parts = list(parts_of(records[0]))
    columns = ("part, ms", *(f"`{record.variant}` {record.size[0]}x{record.size[1]}" for record in records))
    part_lines = [(part, *(number(parts_of(record)[part]) for record in records)) for part in parts]
    return PIPELINES + markdown(frame(headings, lines)) + "\n" + markdown(frame(columns, part_lines))


def _cold_table(records: Sequence[Record]) -> str:
    about = "Whole processes with filled caches, until they end; `enhance` writes one image of {}x{}.\n\n"
    lines = [
        (f"`{record.variant}`", f"{number(record.metrics['milliseconds'] or 0.0)} "
         f"[{number(record.metrics[LOW] or 0.0)}, {number(record.metrics[HIGH] or 0.0)}]")
        for record in records
    ]  # fmt: skip
    return about.format(*records[0].size) + markdown(frame(("process", "ms"), lines))


EQUAL = f"""Mean gain in PSNR over the render, over held-out frames of fits of 1,000 steps, most of them of procedural,
in-distribution scenes. `nafnet`, `edvr`, {LABELS["paper"]}, `sif` and `ssif_lr` were trained on the same runs for the
same number of steps ({EQUAL_PAGE}); the row "{LABELS["paper"]}" is our super SIF, not the paper's
own system (`mode=paper`). `lr_tiny` means the weights of this name when [quality](results/quality.md) was measured, on
other scenes; they learned for longer and from more fits. Time is that of the whole enhancement in bfloat16, so that
methods that align pay for it.

"""


def _quality(sources: PageRecords) -> str:
    gain_by_method = gains(sources)
    if not gain_by_method:
        return "Not measured yet: `nox -s quality`.\n"
    times = {record.variant: record.metrics[TIME] for record in sources.of(ENHANCEMENT) if record.splat == FAST[0]}
    measured = [record.variant.removeprefix("lr/") for record in (*sources.equal_budget, *sources.quality)]
    counts = {name: measured.count(name) for name in gain_by_method}
    lines = []
    for name, gain in gain_by_method.items():
        time = number(value) if (value := times.get(name)) else "not measured"
        lines.append((_code_or_label(name), f"{gain:+.2f}", str(counts[name]), time))
    return EQUAL + markdown(frame(("method", "PSNR, dB", "frames", "whole, ms / MP"), lines))


def performance_plot(sources: PageRecords) -> str:
    """Plot remaining squared error over time as SVG, for the methods whose gain is known."""
    gain_by_method, marks = gains(sources), {}
    for record in sources.of(ENHANCEMENT):
        gain, time = gain_by_method.get(record.variant), record.metrics[TIME]
        if record.splat == FAST[0] and gain is not None and time is not None:
            mark = Mark(f"{gain:+.2f} dB", time, 10 ** (-gain / 10), record.metrics[LOW], record.metrics[HIGH])
            marks[LABELS.get(record.variant, record.variant)] = (mark,)
    panel = Panel(
        "Whole enhancement in bfloat16",
        "milliseconds a megapixel",
        "squared error left, of the render's",
        marks,
        ("render", 1.0) if marks else None,
    )
    return work_precision("Gain in PSNR against time", [panel], 1)


def _tried(records: Sequence[Record]) -> str:
    about = "Both ways in turn, on one view of {}x{} with three references, on the CPU.\n\n"
    headings = ("change", "expected", "before", "after", "times as fast", "verdict")
    return about.format(*records[0].size) + markdown(frame(headings, _tried_lines(records)))


def _tried_lines(records: Sequence[Record]) -> Iterator[Sequence[str]]:
    for record in records:
        values = _known(record)
        before, after = (f"{number(values[name])} ms" for name in ("before", "after"))
        yield record.variant, record.view, before, after, _with_interval(values, "times"), record.splat


def _cards(sources: PageRecords) -> str:
    machines = distinct_values(record.machine for record in sources.records if record.protocol.startswith("GPU"))
    if machines:
        return f"Measured on {'; '.join(machines)}.\n"
    return f"None was at hand: nothing on this page was measured on one. `{MAKE} -- device=cuda` is ready for it.\n"
