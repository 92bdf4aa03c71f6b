"""What every network costs at every size: parameters, multiply-adds and, where asked for, time.

    python -m ablations.benchmarks.networks --json docs/results/networks.json [--times] > table.md
    python -m ablations.benchmarks.networks --mode paper --references 2 --json docs/results/paper_networks.json

Multiply-adds are those of convolutions and matrix products; reading features at moved positions, activations and
interpolation are not among them. Both figures are for a megapixel of the enhanced image. Times are single calls in
bfloat16 and channels-last memory on an otherwise idle machine; networks run in turn, round after round, and the median
is kept.
"""

import argparse
import json
import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gaussian_enhancer  # noqa: F401  # isort: skip  # before torch: it settles how idle OpenMP threads wait
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from gaussian_enhancer.cli.main import configurations
from gaussian_enhancer.infer.weights import NETWORKS, count_parameters, design_of
from gaussian_enhancer.metrics.provenance import this_commit, this_machine
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.types import NetworkInput

SIZES = ("tiny", "base", "large")
ALIGNMENTS = ("reprojected", "deformable")


@dataclass(frozen=True)
class Subject:
    """A network under its names in ``conf``.

    Args:
        fusion: the network's configuration.
        size: of the network; "-" where it makes no difference.
        alignment: of the references; "-" where the network has no part in it.
        network: untrained.
    """

    fusion: str
    size: str
    alignment: str
    network: Network


def subjects(mode: str = "ours") -> Iterator[Subject]:
    """Every network that weights can name, as its own configuration builds it, without variants and repetitions.

    Args:
        mode: "paper": the paper's own networks, and SSIF-SR without its buffer as well; "ours": all others.
    """
    yield from _papers() if mode == "paper" else _ours()


def _papers() -> Iterator[Subject]:
    conf = configurations()
    names = sorted(path.stem.removeprefix("paper_") for path in (conf / "network").glob("paper_*.yaml"))
    with initialize_config_dir(str(conf), version_base="1.3"):
        for fusion in names:
            for buffer in (True, False) if fusion == "ssif_sr" else (True,):
                told = f"{fusion}, paper" + ("" if buffer else ", without its buffer")
                for size in SIZES:
                    unbuffered = [] if buffer else ["+fusion.buffer=false"]
                    cfg = compose("train", ["mode=paper", f"fusion={fusion}", f"size={size}", *unbuffered])
                    yield Subject(told, size, "deformable", build(cfg.fusion).eval())


def _ours() -> Iterator[Subject]:
    conf, built = configurations(), []
    files: dict[str, Any] = {path.stem: OmegaConf.load(path) for path in sorted((conf / "fusion").glob("*.yaml"))}
    kinds = {values.get("_target_", "").rpartition(".")[2]: name for name, values in files.items()}
    with initialize_config_dir(str(conf), version_base="1.3"):
        for kind in (name for name in NETWORKS if name in kinds):
            fusion = kinds[kind]
            said = OmegaConf.to_yaml(compose("train", [f"fusion={fusion}"]).fusion)
            aligned, sized = ("${" + group in said for group in ("alignment", "size"))
            for alignment in ALIGNMENTS if aligned else ("-",):
                for size in SIZES if sized else ("-",):
                    chosen = [f"{k}={v}" for k, v in (("alignment", alignment), ("size", size)) if v != "-"]
                    network = build(compose("train", [f"fusion={fusion}", *chosen]).fusion)
                    if design_of(network) not in built:
                        built.append(design_of(network))
                        yield Subject(fusion, size, alignment, network.eval())


def example(height: int, width: int, references: int) -> NetworkInput:
    """Noise in the form of views that have everything that there may be."""
    generator = torch.Generator().manual_seed(0)

    def noise(*shape: int) -> torch.Tensor:
        return torch.rand(1, *shape, height, width, generator=generator)

    seen = [noise(references, planes) for planes in (3, 1, 3)]
    fine = torch.rand(1, references, 3, 4 * height, 4 * width, generator=generator)
    unit = torch.ones(1)
    return NetworkInput(noise(3), seen[0], seen[1], 1 + noise(1), noise(1), unit, seen[2], fine)


@torch.inference_mode()
def multiply_adds(network: Network, references: int, side: int = 256) -> float:
    """Multiply-adds for each pixel of the enhanced image; nothing is computed."""
    counter = FlopCounterMode(display=False)
    views = example(side, side, references)
    with FakeTensorMode(allow_non_fake_inputs=True), counter:
        enhanced = network(views)
    return counter.get_total_flops() / 2 / enhanced[0, 0].numel()


@torch.inference_mode()
def microseconds(networks: list[Network], views: NetworkInput, rounds: int) -> list[float]:
    """Median time for each pixel of the enhanced image, of each network."""
    times: list[list[float]] = [[] for _ in networks]
    for turn in range(rounds + 1):
        for network, own in zip(networks, times, strict=True):
            begun = time.perf_counter()
            with torch.autocast("cpu", torch.bfloat16):
                pixels = network(views)[0, 0].numel()
            if turn:
                own.append(1e6 * (time.perf_counter() - begun) / pixels)
    return [statistics.median(own) for own in times]


def measured(options: argparse.Namespace) -> dict[str, Any]:
    """The record: where and how it was measured, and a row for each network."""
    found = list(subjects(options.mode))
    height, width = (int(side) for side in options.size.split("x"))
    rows: list[dict[str, Any]] = []
    times = None
    if options.times:
        prepared = [subject.network.to(memory_format=torch.channels_last) for subject in found]  # type: ignore[call-overload]
        times = microseconds(prepared, example(height, width, options.references), options.rounds)
    for index, subject in enumerate(found):
        row = {
            "fusion": subject.fusion,
            "alignment": subject.alignment,
            "size": subject.size,
            "scale": subject.network.scale,
            "parameters": count_parameters(subject.network),
            "giga_multiply_adds_per_megapixel": round(multiply_adds(subject.network, options.references) / 1e3, 2),
        }
        rows.append(row if times is None else {**row, "seconds_per_megapixel": round(times[index], 4)})
    how = {"size": options.size, "rounds": options.rounds, "threads": torch.get_num_threads(), "precision": "bfloat16"}
    return {
        "references": options.references,
        "times": how if options.times else None,
        "rows": rows,
        "machine": this_machine(),
        "commit": this_commit(),
    }


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as a Markdown table."""
    heads = ["network", "alignment", "size", "scale", "parameters", "10^9 multiply-adds / MP"]
    timed = "seconds_per_megapixel" in rows[0]
    lines = [heads + ["s / MP"] * timed, ["---"] * (len(heads) + timed)]
    for row in rows:
        name, alignment, size, scale, parameters, work, *seconds = row.values()
        lines.append([f"`{name}`", alignment, size, f"{scale}x", f"{parameters:,}", f"{work:,.1f}"])
        lines[-1] += [f"{value:.3f}" for value in seconds]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Read the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mode", choices=("ours", "paper"), default="ours")
    parser.add_argument("--references", type=int, default=3)
    parser.add_argument("--times", action="store_true", help="measure times too; wants an idle machine")
    parser.add_argument("--size", default="192x256", help="HEIGHTxWIDTH of the render, for times")
    parser.add_argument("--rounds", type=int, default=7, help="of times")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    record = measured(options)
    print(table(record["rows"]))
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
