"""The page on performance: aims, networks beside published ones, the pipeline part by part, from records alone."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ablations.study.markdown import frame, markdown
from ablations.study.plots import Mark, Panel, work_precision
from ablations.study.sections import source_list
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.metrics.comparison import compare, paired
from gaussian_enhancer.metrics.records import MISSING, Record

YARDSTICK, NETWORK, ENHANCEMENT, PIPELINE, COLD, TRIED = (
    "yardstick", "network", "enhancement", "pipeline", "cold", "tried",
)  # fmt: skip
"""Kinds of records."""
GROUPS = ("ours", "published")
COMMAND, IMPORTS = "enhance", "import torch"
"""Processes whose start is measured."""
FAST = ("bfloat16", "bfloat16 weights")
"""Number types that are held against ours in bfloat16."""
QUALITY = ("nafnet", "edvr", "paper", "sif", "lr_2500", "lr_tiny", "lr_base")
"""Rows of docs/results/quality.md; those that begin with lr_tiny had more training."""
MAKE = "nox -s bench"
NOTHING = f"Not measured yet: `{MAKE}`.\n"


@dataclass(frozen=True)
class Sources:
    """What the page is made from.

    Args:
        records: of the job ``peers``.
        quality: of the job ``quality``.
    """

    records: tuple[Record, ...] = ()
    quality: tuple[Record, ...] = ()

    FILES: ClassVar[tuple[str, ...]] = ("records", "quality")

    def of(self, kind: str, name: str = "") -> tuple[Record, ...]:
        """The job's records of a kind, and of a name where one is given."""
        return tuple(one for one in self.records if one.kind == kind and name in ("", one.variant))

    def pipeline(self, name: str, size: tuple[int, int]) -> Record | None:
        """A pipeline's record by weights, width and height."""
        return next((one for one in self.of(PIPELINE, name) if tuple(one.size) == size), None)


@dataclass(frozen=True)
class Target:
    """An aim of the project.

    Args:
        part: what is aimed at.
        limit: the number.
        unit: of it.
        value: what was measured; None where it was not.
        bound: what holds the number up, in words.
        most: the number is the most that is allowed; else it is the least.
    """

    part: str
    limit: float
    unit: str
    value: Callable[[Sources], float | None]
    bound: Callable[[Sources], str]
    most: bool = True

    def line(self, sources: Sources) -> tuple[str, str, str, str, str]:
        """Part, aim, what was measured, verdict, bound."""
        found = self.value(sources)
        aim = f"{'at most' if self.most else 'at least'} {self.limit:,g} {self.unit}".rstrip()
        if found is None:
            return self.part, aim, "not measured", "", ""
        met = found <= self.limit if self.most else found >= self.limit
        return (
            self.part,
            aim,
            f"{number(found)} {self.unit}".rstrip(),
            "met" if met else "**missed**",
            self.bound(sources),
        )


def number(value: float) -> str:
    """A number in about three digits."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def gains(sources: Sources) -> dict[str, float]:
    """Mean gain in PSNR over the render, dB, by method, over the views of docs/results/quality.md."""
    measured = {record.variant for record in sources.quality if record.kind == "quality"}
    known = [name for name in QUALITY if f"lr/{name}" in measured and "lr/raw" in measured]
    return {n: compare(paired(sources.quality, "lr/raw", f"lr/{n}"), "psnr").gain for n in known}


def times_ours(sources: Sources, name: str) -> float | None:
    """A network's time over our whole enhancement's, in the number type that suits the network best."""
    found = [one.metrics.get("times_ours") for one in sources.of(NETWORK, name) if one.splat in FAST]
    return min((value for value in found if value is not None), default=None)


def parts_of(record: Record) -> dict[str, float]:
    """Milliseconds by part of a pipeline's record."""
    found = {name.removeprefix("part: "): value for name, value in record.metrics.items() if name.startswith("part: ")}
    return {name: value for name, value in found.items() if value is not None}


def shares(record: Record | None) -> str:
    """The parts that take most of the time from decoded images on, in words."""
    if record is None:
        return ""
    parts = {name: value for name, value in parts_of(record).items() if name != "read"}
    total = sum(parts.values()) or 1.0
    first = sorted(parts.items(), key=lambda one: -one[1])[:4]
    return ", ".join(f"{name} {value / total:.0%}" for name, value in first)


def _metric(record: Record | None, name: str) -> float | None:
    return None if record is None else record.metrics.get(name)


def _growth(sources: Sources) -> float | None:
    """Largest over least time a megapixel, from a quarter of a megapixel on."""
    large = [one for one in sources.of(PIPELINE, "lr_tiny") if one.size[0] * one.size[1] >= 0.25e6]
    times = [value for one in large if (value := one.metrics[TIME]) is not None]
    return max(times) / min(times) if len(times) > 1 else None


def _operations(sources: Sources, name: str) -> float | None:
    found = sources.of(NETWORK, name)
    return found[0].metrics["giga_multiply_adds_per_megapixel"] if found else None


def _cold(sources: Sources, name: str) -> float | None:
    found = sources.of(COLD, name)
    return found[0].metrics["milliseconds"] if found else None


def _pipeline_target(part: str, limit: float, unit: str, name: str, size: tuple[int, int], metric: str) -> Target:
    def record(sources: Sources) -> Record | None:
        return sources.pipeline(name, size)

    if metric == "peak_memory_mb":
        return Target(part, limit, unit, lambda s: _metric(record(s), metric), lambda _: "decoded images and features")
    return Target(part, limit, unit, lambda s: _metric(record(s), metric), lambda s: shares(record(s)))


def _peer_target(name: str, limit: float) -> Target:
    about = "our time holds alignment and all limits to the change, theirs the network alone"
    return Target(
        f"`lr_tiny`, times as fast as {name}", limit, "", lambda s: times_ours(s, name), lambda _: about, most=False
    )


def _better_target(name: str) -> Target:
    def value(sources: Sources) -> float | None:
        found = gains(sources)
        return found["lr_2500"] - found[name] if {"lr_2500", name} <= set(found) else None

    part = f"PSNR beyond `{name}` at equal budget"
    return Target(part, 0.0, "dB", value, lambda _: "[quality](results/quality.md)", most=False)


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
        "start of `enhance` to its first image", 2000.0, "ms", lambda s: _cold(s, COMMAND),
        lambda s: f"`import torch` alone takes {number(_cold(s, IMPORTS) or 0.0)} ms",
    ),
    Target(
        "largest over least time a megapixel, from 0.25 megapixels on", 1.1, "", _growth,
        lambda s: f"at the largest size: {shares(max(s.of(PIPELINE, 'lr_tiny'), key=lambda r: r.size, default=None))}",
    ),
    _peer_target("NAFNet-w32", 15.0),
    _peer_target("Restormer", 50.0),
    _peer_target("edvr, base", 50.0),
    Target("`lr_tiny`, 10^9 multiply-adds / MP", 20.0, "", lambda s: _operations(s, "lr_tiny"), lambda _: WIDTHS),
    Target("`lr_base`, 10^9 multiply-adds / MP", 100.0, "", lambda s: _operations(s, "lr_base"), lambda _: WIDTHS),
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


def performance_page(sources: Sources, files: Mapping[str, Path], drawing: Path, page: Path) -> str:
    """The page as Markdown.

    Args:
        sources: records.
        files: where they are, by the name of their field.
        drawing: the diagram's file.
        page: the page's file, for links.
    """

    def link(path: Path) -> str:
        return Path(os.path.relpath(path, page.parent)).as_posix()

    parts = [HEAD.format(make=MAKE)]
    lines = [target.line(sources) for target in TARGETS]
    parts += ["## Aims\n\n", markdown(frame(("part", "aim", "measured", "verdict", "what bounds it"), lines))]
    parts += ["\n", ELSEWHERE, "\n## Yardsticks\n\n", _yardsticks(sources)]
    parts += ["\n## Networks\n\n", _networks(sources)]
    parts += [
        "\n## The whole pipeline\n\n",
        _pipelines(sources),
        "\n## Start of the command line\n\n",
        _cold_table(sources),
    ]
    parts += ["\n## Quality of the equal-budget peers\n\n", _quality(sources)]
    parts += [f"\n![gain in PSNR against time]({link(drawing)})\n"]
    parts += ["\n## What was tried\n\n", _tried(sources), "\n## Graphics cards\n\n", _cards(sources)]
    parts += ["\n## Sources\n\n"]
    for name in sources.FILES:
        own = getattr(sources, name)
        parts.append(source_list(own, link(files[name]), between="; or ") if own else "")
    return "".join(parts)


def _yardsticks(sources: Sources) -> str:
    found = sources.of(YARDSTICK)
    if not found:
        return NOTHING
    lines = [
        (
            one.variant,
            number(one.metrics["milliseconds"] or 0.0),
            f"{number(one.metrics['a_second'] or 0.0)} {one.view}",
        )
        for one in found
    ]
    return markdown(frame(("workload", "ms", "a second"), lines))


NETWORKS = """Time and multiply-adds are for a megapixel of the image that comes out; the input is {width}x{height}.
"Network" is the forward pass alone, of ours with references on the target's grid already; "whole" is everything from
decoded images on: planning, search of depth, alignment, network, limits to the change. Published networks have random
weights. "Arithmetic" is what the multiply-adds would take at the convolution's rate, "memory" what the operations'
reads and writes would take at the copy's; caches save some of that. "Times ours" is the time of a network divided by
that of our whole enhancement at the same scale, `lr_tiny` or `sr_tiny`, with the interval of the rounds' median.

"""


def _networks(sources: Sources) -> str:
    found = [*sources.of(NETWORK), *sources.of(ENHANCEMENT)]
    if not found:
        return NOTHING
    rates = {one.variant: one.metrics["a_second"] or 1.0 for one in sources.of(YARDSTICK)}
    heads = ("network", "of", "what", "number type", "scale", "parameters", "10^9 multiply-adds / MP", "ms / MP",
             "arithmetic, ms / MP", "memory, ms / MP", "yardsticks", "times ours", "peak MB")  # fmt: skip
    lines = [_network_line(one, rates) for one in found]
    text = NETWORKS.format(width=found[0].size[0], height=found[0].size[1]) + markdown(frame(heads, lines))
    missing = [f"- `{one.variant}`, {one.splat}: {one.reasons['row']}\n" for one in sources.of(MISSING)]
    return text + ("\nMissing:\n\n" + "".join(missing) if missing else "")


def _network_line(one: Record, rates: Mapping[str, float]) -> tuple[str, ...]:
    values = {name: value for name, value in one.metrics.items() if value is not None}
    rate = rates["convolution, float32" if one.splat == "float32" else "convolution, bfloat16"]
    return (
        f"`{one.variant}`" if one.scene == GROUPS[0] else one.variant,
        one.scene,
        "whole" if one.kind == ENHANCEMENT else "network",
        one.splat,
        f"{values['scale']:.0f}x",
        f"{values['parameters']:,.0f}",
        f"{values['giga_multiply_adds_per_megapixel']:,.1f}",
        f"{number(values[TIME])} [{number(values[LOW])}, {number(values[HIGH])}]",
        number(1e3 * values["giga_multiply_adds_per_megapixel"] / rate),
        number(1e3 * values["gigabytes_per_megapixel"] / rates["copy"]),
        number(values["yardsticks"]),
        _with_ends(values, "times_ours"),
        number(values["peak_memory_mb"]) if "peak_memory_mb" in values else "",
    )


def _with_ends(values: Mapping[str, float], name: str) -> str:
    if name not in values:
        return ""
    return f"{number(values[name])} [{number(values[f'{name}_low'])}, {number(values[f'{name}_high'])}]"


PIPELINES = """Views of a procedural scene, in the number type that `precision=auto` takes. "File to file" reads the
render and five candidate photos with their renders and depth, enhances, and writes a PNG; "decoded" leaves reading out.

"""


def _pipelines(sources: Sources) -> str:
    found = sources.of(PIPELINE)
    if not found:
        return NOTHING
    heads = ("weights", "render", "output MP", "file to file, ms", "decoded, ms", "decoded, ms / MP", "yardsticks",
             "peak MB")  # fmt: skip
    lines = []
    for one in found:
        values = {name: value for name, value in one.metrics.items() if value is not None}
        width, height = one.size
        lines.append((
            f"`{one.variant}`", f"{width}x{height}", f"{width * height * values['scale'] ** 2 / 1e6:.2f}",
            number(values["milliseconds"]), number(values["decoded_milliseconds"]), number(values[TIME]),
            number(values["yardsticks"]), number(values["peak_memory_mb"]) if "peak_memory_mb" in values else "",
        ))  # fmt: skip
    parts = list(parts_of(found[0]))
    columns = ("part, ms", *(f"`{one.variant}` {one.size[0]}x{one.size[1]}" for one in found))
    each = [(part, *(number(parts_of(one)[part]) for one in found)) for part in parts]
    return PIPELINES + markdown(frame(heads, lines)) + "\n" + markdown(frame(columns, each))


def _cold_table(sources: Sources) -> str:
    found = sources.of(COLD)
    if not found:
        return NOTHING
    about = "Whole processes with filled caches, until they end; `enhance` writes one image of {}x{}.\n\n"
    lines = [
        (f"`{one.variant}`", f"{number(one.metrics['milliseconds'] or 0.0)} "
         f"[{number(one.metrics[LOW] or 0.0)}, {number(one.metrics[HIGH] or 0.0)}]")
        for one in found
    ]  # fmt: skip
    return about.format(*found[0].size) + markdown(frame(("process", "ms"), lines))


EQUAL = """Mean gain in PSNR over the render, over the held-out frames of [quality](results/quality.md). `nafnet`,
`edvr`, `paper`, `sif` and `lr_2500` were trained on the same runs for the same 2,500 steps; `lr_tiny` and `lr_base` are
shipped and had more. Time is that of the whole enhancement in bfloat16, so that methods that align pay for it.

"""


def _quality(sources: Sources) -> str:
    found = gains(sources)
    if not found:
        return "Not measured yet: `nox -s quality`.\n"
    times = {one.variant: one.metrics[TIME] for one in sources.of(ENHANCEMENT) if one.splat == FAST[0]}
    counts = {name: sum(one.variant == f"lr/{name}" for one in sources.quality) for name in found}
    lines = [
        (
            f"`{name}`",
            f"{gain:+.2f}",
            str(counts[name]),
            number(value) if (value := times.get(name)) else "not measured",
        )
        for name, gain in found.items()
    ]
    return EQUAL + markdown(frame(("method", "PSNR, dB", "frames", "whole, ms / MP"), lines))


def performance_plot(sources: Sources) -> str:
    """Work-precision diagram as SVG: squared error left over time, for the methods whose gain is known."""
    found, marks = gains(sources), {}
    for one in sources.of(ENHANCEMENT):
        gain, time = found.get(one.variant), one.metrics[TIME]
        if one.splat == FAST[0] and gain is not None and time is not None:
            mark = Mark(f"{gain:+.2f} dB", time, 10 ** (-gain / 10), one.metrics[LOW], one.metrics[HIGH])
            marks[one.variant] = (mark,)
    panel = Panel(
        "Whole enhancement in bfloat16",
        "milliseconds a megapixel",
        "squared error left, of the render's",
        marks,
        ("render", 1.0) if marks else None,
    )
    return work_precision("Gain in PSNR against time", [panel], 1)


def _tried(sources: Sources) -> str:
    found = sources.of(TRIED)
    if not found:
        return NOTHING
    about = "Both ways in turn, on one view of {}x{} with three references, on the CPU.\n\n"
    heads = ("change", "expected", "before", "after", "times as fast", "verdict")
    return about.format(*found[0].size) + markdown(frame(heads, _tried_lines(found)))


def _tried_lines(found: Sequence[Record]) -> Iterator[Sequence[str]]:
    for one in found:
        values = {name: value for name, value in one.metrics.items() if value is not None}
        before, after = (f"{number(values[name])} ms" for name in ("before", "after"))
        yield one.variant, one.view, before, after, _with_ends(values, "times"), one.splat


def _cards(sources: Sources) -> str:
    measured = sorted({one.machine for one in sources.records if one.protocol.startswith("GPU")})
    if measured:
        return f"Measured on {'; '.join(measured)}.\n"
    return f"None was at hand: nothing on this page was measured on one. `{MAKE} -- device=cuda` is ready for it.\n"
