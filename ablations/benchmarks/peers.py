"""``gaussian-enhancer peers``: speed and memory of our networks, of published ones, and of the pipeline, in one run.

Networks run in turn, round after round, on the same input, and so do fixed workloads, the yardsticks. Each time is also
given as a ratio to a convolution within the same round, which allows comparisons between machines and days. The job
then measures the whole pipeline from files to a file, part by part at several sizes, and the start of the command line.
The page is made from the records alone.
"""

import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from omegaconf import DictConfig
from rich.console import Console

from ablations.benchmarks.peak_above_imports import enhancement_peak, network_peak
from ablations.benchmarks.peer_networks import (
    CAST,
    DTYPES,
    Call,
    Peer,
    built,
    enhancement,
    forward,
    names,
    number_types,
    work,
    yardsticks,
)
from ablations.benchmarks.pipeline_parts import READ, PartTimer, clocked_parts, write_clocked
from ablations.benchmarks.synthetic_views import read_views, synthetic_views, write_views
from ablations.benchmarks.trials import trials
from ablations.report.performance import (
    COLD,
    COMMAND,
    ENHANCEMENT,
    GROUPS,
    IMPORTS,
    NETWORK,
    PIPELINE,
    TRIED,
    YARDSTICK,
    PageRecords,
    performance_page,
    performance_plot,
)
from ablations.study.cost import device_description, quartiles, times_faster
from ablations.study.engine import Study, job, refuse_narrowed
from ablations.study.missing import missing_record, reason_of
from ablations.tradeoff.summary import HIGH, LOW, TIME
from gaussian_enhancer.console import print_line
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.infer.weights import count_parameters
from gaussian_enhancer.metrics.cost import Timing, time_interleaved
from gaussian_enhancer.metrics.records import Record, read_records

OURS = {1: "lr_tiny", 4: "sr_tiny"}
"""By scale, the weights whose whole enhancement others are compared with."""
SMALL = (240, 320)
"""Height and width of the views of the uncounted first call for memory; large enough to reach every part."""

Views = Callable[[int, int, bool], Path]
"""A folder of views by height, width, and whether photos are 4 times as fine."""


@dataclass(frozen=True)
class NetworkCall:
    """A network in a number type, alone or in a whole enhancement.

    Args:
        peer: the network.
        dtype: one of `DTYPES`.
        whole: whether the call is a whole enhancement of decoded images.
        run: makes one pass.
    """

    peer: Peer
    dtype: str
    whole: bool
    run: Call

    @property
    def key(self) -> str:
        """Unique among the calls."""
        return f"{self.peer.name}/{self.dtype}/{ENHANCEMENT if self.whole else NETWORK}"


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """Networks, pipeline and command line, in one process; the page and its diagram.

    Raises:
        InputError: some networks alone would be measured, and replace the committed records of all.
    """
    for narrowing in () if cfg.records_only else ("networks", "dtypes"):
        refuse_narrowed("peers", cfg, narrowing, "records", "records=FILE page=PAGE")
    console = Console(stderr=True)

    def measure(_: str) -> Iterator[Record]:
        with TemporaryDirectory() as folder:
            yield from measured(cfg, device, Path(folder), console)

    parts = () if cfg.records_only else ("all",)
    return Study(
        parts, measure, ("kind", "scene", "variant"), replaces_file=True, report=lambda: reported(cfg, console)
    )


run = job(study)


def reported(cfg: DictConfig, console: Console) -> None:
    """Write the page and its diagram.

    Raises:
        InputError: a file cannot be read or written.
    """
    page, drawing = Path(cfg.page), Path(cfg.records).with_suffix(".svg")
    records = {name: read_records(file) if (file := Path(cfg[name])).is_file() else () for name in PageRecords.FILES}
    sources = PageRecords(**records)
    write_text(drawing, performance_plot(sources))
    write_text(page, performance_page(sources, {name: Path(cfg[name]) for name in PageRecords.FILES}, drawing, page))
    print_line(console, f"{page}, {drawing}")


def measured(cfg: DictConfig, device: torch.device, folder: Path, console: Console) -> Iterator[Record]:
    """All records.

    Args:
        cfg: conf/peers.yaml, composed.
        device: where networks run.
        folder: empty, for views and images.
        console: prints what is measured.
    """
    folders: dict[tuple[int, int, bool], Path] = {}

    def views(height: int, width: int, finer: bool) -> Path:
        """A folder of views of a size, written once."""
        key = height, width, finer
        if key not in folders:
            folders[key] = folder / f"{width}x{height}{'x4' if finer else ''}"
            write_views(synthetic_views(height, width, cfg.family, finer), folders[key])
        return folders[key]

    peers = [built(cfg, name, device) for name in names(cfg)]
    console.print("networks", highlight=False)
    yield from network_records(cfg, peers, device, views)
    console.print("pipeline", highlight=False)
    yield from pipeline_records(cfg, device, views, folder)
    console.print("what was tried", highlight=False)
    yield from tried_records(cfg)
    console.print("start of the command line", highlight=False)
    yield from cold_records(cfg, views(*SMALL, False), folder)


def network_records(cfg: DictConfig, peers: list[Peer], device: torch.device, views: Views) -> Iterator[Record]:
    """Yardsticks, then every network in every number type, alone; ours also in a whole enhancement."""
    fixed = {name: (run, amount, unit) for name, run, amount, unit in yardsticks(device)}
    dtypes = {name: DTYPES[name] for name in cfg.dtypes}
    amounts: dict[tuple[str, str], tuple[float, float]] = {}
    runnable: dict[str, NetworkCall] = {}
    for call in _network_calls(cfg, peers, dtypes, device):
        try:
            call.run()
        except RuntimeError as error:  # some published networks mix number types in their code
            yield missing_record(call.peer.name, reason_of(error).splitlines()[0], splat=call.dtype, view=NETWORK)
            continue
        amounts[call.peer.name, call.dtype] = work(call.peer, call.dtype, cfg.references)
        runnable[call.key] = call
    calls = {name: run for name, (run, _, _) in fixed.items()} | {key: call.run for key, call in runnable.items()}
    times = time_interleaved(calls, cfg.rounds, 1, device)
    protocol = _protocol(cfg, device)
    for name, (_, amount, unit) in fixed.items():
        rate: dict[str, float | None] = {
            "milliseconds": times[name].milliseconds,
            "a_second": amount / times[name].milliseconds * 1e3,
        }
        yield Record(YARDSTICK, "", "", "", unit, name, rate, protocol=protocol)
    for key, call in runnable.items():
        megapixels = cfg.height * cfg.width * call.peer.scale**2 / 1e6
        operations, moved = amounts[call.peer.name, call.dtype]
        yardstick = times["convolution, float32" if call.dtype == "float32" else "convolution, bfloat16"]
        metrics: dict[str, float | None] = {
            "parameters": float(count_parameters(call.peer.network)),
            "scale": float(call.peer.scale),
            "giga_multiply_adds_per_megapixel": operations / 1e3,
            "gigabytes_per_megapixel": moved / 1e3,
            **_time(times[key], megapixels, yardstick),
        }
        ours = f"{OURS.get(call.peer.scale)}/{'bfloat16' if call.dtype == CAST else call.dtype}/{ENHANCEMENT}"
        if ours in times:
            columns = ("times_ours", "times_ours_low", "times_ours_high")
            metrics |= dict(zip(columns, times_faster(times[ours], times[key]), strict=True))
        if cfg.memory:
            metrics["peak_memory_mb"] = _peak(cfg, call, views)
        published = call.peer.pretrained is None
        keys = ENHANCEMENT if call.whole else NETWORK, "", GROUPS[int(published)], call.dtype, "", call.peer.name
        yield Record(*keys, metrics, size=(cfg.width, cfg.height), protocol=protocol)


def _network_calls(
    cfg: DictConfig, peers: list[Peer], dtypes: Mapping[str, torch.dtype], device: torch.device
) -> Iterator[NetworkCall]:
    for peer in peers:
        for dtype in number_types(peer, dtypes):
            yield NetworkCall(peer, dtype, False, forward(peer, dtype, cfg.height, cfg.width, cfg.references))
            if peer.pretrained is not None:
                rendered = synthetic_views(cfg.height, cfg.width, cfg.family, peer.scale > 1)
                yield NetworkCall(peer, dtype, True, enhancement(peer, dtype, rendered, device))


def _peak(cfg: DictConfig, call: NetworkCall, views: Views) -> float:
    if not call.whole:
        return network_peak(cfg, call.peer.name, call.dtype)
    finer = call.peer.scale > 1
    return enhancement_peak(cfg, call.peer.name, call.dtype, views(cfg.height, cfg.width, finer), views(*SMALL, finer))


def pipeline_records(cfg: DictConfig, device: torch.device, views: Views, folder: Path) -> Iterator[Record]:
    """The pipeline from files to a file, part by part, for all weights at all sizes."""
    timer, calls, cases = PartTimer(device), {}, {}
    for name, sizes in cfg.pipeline.items():
        peer = built(cfg, name, device)
        for width, height in (map(int, size.split("x")) for size in sizes):
            views_folder, key = views(height, width, peer.scale > 1), f"{name}/{width}x{height}"
            cases[key] = peer, height, width, views_folder
            enhance = enhancement(peer, "auto", read_views(views_folder), device)
            calls[key] = partial(_to_file, key, enhance, timer, folder / "enhanced.png")
    fixed = {name: call for name, call, _, _ in yardsticks(device)}
    with clocked_parts(timer):
        times = time_interleaved({**fixed, **calls}, cfg.rounds, 1, device)
    for key, (peer, height, width, views_folder) in cases.items():
        laps = timer.laps[key][1:]  # without the warm-up
        decoded = _timing([sum(lap.values()) - lap[READ] for lap in laps])
        metrics: dict[str, float | None] = {
            "scale": float(peer.scale),
            "milliseconds": times[key].milliseconds,
            "decoded_milliseconds": decoded.milliseconds,
            **_time(decoded, height * width * peer.scale**2 / 1e6, times["convolution, bfloat16"]),
            **{f"part: {part}": _timing([lap[part] for lap in laps]).milliseconds for part in laps[0]},
        }
        if cfg.memory:
            small = views(*SMALL, peer.scale > 1)
            metrics["peak_memory_mb"] = enhancement_peak(cfg, peer.name, "auto", views_folder, small)
        yield Record(
            PIPELINE, "", "", "", "", peer.name, metrics, size=(width, height), protocol=_protocol(cfg, device)
        )


def tried_records(cfg: DictConfig) -> Iterator[Record]:
    """Every trial's two versions in turn, on the CPU."""
    width, height = map(int, cfg.tried.split("x"))
    read_photo = synthetic_views(height, width, cfg.family).targets[0].read_photo
    if read_photo is None:
        raise ValueError("synthetic views have photos")
    all_trials = list(trials(height, width, read_photo()))
    calls = {f"{i} {name}": getattr(trial, name) for i, trial in enumerate(all_trials) for name in ("before", "after")}
    with torch.inference_mode():
        times = time_interleaved(calls, cfg.rounds, 1)
    for i, trial in enumerate(all_trials):
        before, after = (times[f"{i} {name}"] for name in ("before", "after"))
        ratio, low, high = times_faster(after, before)
        metrics: dict[str, float | None] = {"before": before.milliseconds, "after": after.milliseconds}
        metrics |= {"times": ratio, "times_low": low, "times_high": high}
        verdict = "kept" if trial.kept else "dropped"
        protocol = _protocol(cfg, torch.device("cpu"))
        keys = TRIED, "", "", verdict, trial.expected, trial.change
        yield Record(*keys, metrics, size=(width, height), protocol=protocol)


def cold_records(cfg: DictConfig, views: Path, folder: Path) -> Iterator[Record]:
    """Whole processes: the job enhance until its one image is written, and the import of torch alone."""
    threads = [] if cfg.runtime.threads is None else [f"runtime.threads={cfg.runtime.threads}"]
    words = [f"run={views}", f"output={folder / 'first'}", f"runtime.device={cfg.runtime.device}", *threads]
    commands = {
        COMMAND: [sys.executable, "-m", "gaussian_enhancer", "enhance", *words],
        IMPORTS: [sys.executable, "-c", "import torch"],
    }
    calls = {name: partial(_process, command) for name, command in commands.items()}
    for name, timing in time_interleaved(calls, cfg.cold_rounds, 1).items():
        ends = dict(zip((LOW, HIGH), quartiles(timing), strict=True))
        metrics: dict[str, float | None] = {"milliseconds": timing.milliseconds, **ends}
        yield Record(COLD, "", "", "", "", name, metrics, size=SMALL[::-1], protocol="whole processes, caches filled")


def _process(command: list[str]) -> None:
    """Run a command with Python's bytecode cache on, as in installations, whatever this process uses."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if process.returncode:
        last_line = (process.stderr.strip().splitlines() or ["no output"])[-1]
        raise InputError(" ".join(command[1:]), f"fails ({last_line})", "try it by itself")


def _to_file(name: str, enhance: Call, timer: PartTimer, path: Path) -> None:
    with timer.lap(name):
        write_clocked(enhance(), path)


def _timing(values: list[float]) -> Timing:
    return Timing(statistics.median(values), tuple(values))


def _time(timing: Timing, megapixels: float, yardstick: Timing) -> dict[str, float | None]:
    """Milliseconds a megapixel with quartiles, and the median of the rounds' ratios to the yardstick."""
    low, high = quartiles(timing)
    ratio, ratio_low, ratio_high = times_faster(yardstick, timing)
    return {
        TIME: timing.milliseconds / megapixels,
        LOW: low / megapixels,
        HIGH: high / megapixels,
        "yardsticks": ratio,
        "yardsticks_low": ratio_low,
        "yardsticks_high": ratio_high,
    }


def _protocol(cfg: DictConfig, device: torch.device) -> str:
    memory = "allocated on the device" if device.type == "cuda" else "of a process of its own, above its imports"
    rounds = f"medians of {cfg.rounds} interleaved rounds after a warm-up"
    return f"{device_description(device)}: {rounds}; channels-last; nothing by torch.compile; memory {memory}"
