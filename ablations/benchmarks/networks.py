"""``gaussian-enhancer networks``: parameters, multiply-adds and time of every network at every size.

Multiply-adds are those of convolutions and matrix products, without sampling at offsets, activations and
interpolation. Both figures are for a megapixel of the enhanced image. Times are single calls in bfloat16 and
channels-last memory on an otherwise idle machine; networks run in turn, round after round, and the median is kept.
"""

from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import pandas as pd
import torch
from hydra import compose
from omegaconf import DictConfig, OmegaConf
from torch._subclasses.fake_tensor import DataDependentOutputException, FakeTensorMode
from torch.utils.flop_counter import FlopCounterMode

from ablations.study.engine import Study, job
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.infer.weights import NETWORKS, count_parameters, design_of
from gaussian_enhancer.metrics.cost import time_interleaved
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
        size: of the network; "-" where the network has no sizes.
        alignment: of the references; "-" where it does not change the network.
        network: untrained.
    """

    fusion: str
    size: str
    alignment: str
    network: Network


def subjects(paper: bool = False) -> Iterator[Subject]:
    """Every network that weights can name, as its own configuration builds it, without variants and duplicates.

    Hydra must be initialised with the project's configurations, as it is within a job.

    Args:
        paper: the paper's own networks, and SSIF-SR without its buffer as well, instead of all others.
    """
    yield from _papers() if paper else _ours()


def _papers() -> Iterator[Subject]:
    conf = configurations()
    names = sorted(path.stem.removeprefix("paper_") for path in (conf / "network").glob("paper_*.yaml"))
    for fusion in names:
        for buffer in (True, False) if fusion == "ssif_sr" else (True,):
            description = f"{fusion}, paper" + ("" if buffer else ", without its buffer")
            for size in SIZES:
                unbuffered = [] if buffer else ["+fusion.buffer=false"]
                cfg = compose("train", ["mode=paper", f"fusion={fusion}", f"size={size}", *unbuffered])
                yield Subject(description, size, "deformable", build(cfg.fusion).eval())


def _ours() -> Iterator[Subject]:
    conf, built = configurations(), []
    files: dict[str, Any] = {path.stem: OmegaConf.load(path) for path in sorted((conf / "fusion").glob("*.yaml"))}
    kinds = {values.get("_target_", "").rpartition(".")[2]: name for name, values in files.items()}
    for kind in (name for name in NETWORKS if name in kinds):
        fusion = kinds[kind]
        fusion_yaml = OmegaConf.to_yaml(compose("train", [f"fusion={fusion}"]).fusion)
        aligned, sized = ("${" + group in fusion_yaml for group in ("alignment", "size"))
        for alignment in ALIGNMENTS if aligned else ("-",):
            for size in SIZES if sized else ("-",):
                chosen = [f"{k}={v}" for k, v in (("alignment", alignment), ("size", size)) if v != "-"]
                network = build(compose("train", [f"fusion={fusion}", *chosen]).fusion)
                if design_of(network) not in built:
                    built.append(design_of(network))
                    yield Subject(fusion, size, alignment, network.eval())


def example(height: int, width: int, references: int) -> NetworkInput:
    """Noise as network input with every optional part."""
    generator = torch.Generator().manual_seed(0)

    def noise(*shape: int) -> torch.Tensor:
        return torch.rand(1, *shape, height, width, generator=generator)

    photos, visibility, renders = (noise(references, planes) for planes in (3, 1, 3))
    fine = torch.rand(1, references, 3, 4 * height, 4 * width, generator=generator)
    unit = torch.ones(1)
    return NetworkInput(noise(3), photos, visibility, 1 + noise(1), noise(1), unit, renders, fine)


def multiply_adds(network: Network, references: int, side: int = 256) -> float:
    """Multiply-adds for each pixel of the enhanced image, without computing values unless the network reads them."""
    views = example(side, side, references)
    return counted(lambda: network(views))


@torch.inference_mode()
def counted(call: Callable[[], torch.Tensor]) -> float:
    """Multiply-adds for each pixel of the images that a call returns, shape (batch, 3, height, width).

    Args:
        call: computes them; its convolutions and matrix products are counted, without computing them where possible.
    """
    for mode in (FakeTensorMode(allow_non_fake_inputs=True), nullcontext()):
        counter = FlopCounterMode(display=False)
        with suppress(DataDependentOutputException), mode, counter:
            enhanced = call()
            return counter.get_total_flops() / 2 / enhanced[:, 0].numel()
    raise RuntimeError("the multiply-adds were not counted")


@torch.inference_mode()
def microseconds(networks: list[Network], views: NetworkInput, rounds: int) -> list[float]:
    """Median time for each pixel of the enhanced image, of each network."""

    def enhance(network: Network) -> int:
        with torch.autocast("cpu", torch.bfloat16):
            return network(views)[0, 0].numel()

    calls = {str(index): partial(enhance, network) for index, network in enumerate(networks)}
    pixels = [call() for call in calls.values()]
    times = time_interleaved(calls, rounds, warm_up=0)
    return [1e3 * timing.milliseconds / count for timing, count in zip(times.values(), pixels, strict=True)]


def measured(cfg: DictConfig) -> Iterator[dict[str, Any]]:
    """A row for each network.

    Args:
        cfg: conf/networks.yaml, composed.
    """
    networks = list(subjects(cfg.paper))
    times: list[dict[str, Any]] = [{} for _ in networks]
    if cfg.times:
        prepared = [subject.network.to(memory_format=torch.channels_last) for subject in networks]  # type: ignore[call-overload]
        per_megapixel = microseconds(prepared, example(cfg.height, cfg.width, cfg.references), cfg.rounds)
        conditions = {
            "timed_on": f"{cfg.height}x{cfg.width}",
            "threads": torch.get_num_threads(),
            "precision": "bfloat16",
        }
        times = [{"seconds_per_megapixel": round(seconds, 4), **conditions} for seconds in per_megapixel]
    for subject, time in zip(networks, times, strict=True):
        yield {
            "fusion": subject.fusion,
            "alignment": subject.alignment,
            "size": subject.size,
            "scale": subject.network.scale,
            "parameters": count_parameters(subject.network),
            "giga_multiply_adds_per_megapixel": round(multiply_adds(subject.network, cfg.references) / 1e3, 2),
            "references": cfg.references,
            **time,
        }


def format_networks(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows with the network's name as Markdown prints code."""
    return frame.assign(network="`" + frame["fusion"] + "`")


def study(cfg: DictConfig, device: torch.device) -> Study[DictConfig]:
    """All networks, timed in turn."""
    refuse_gpu(device)
    return Study([cfg], measured, ("fusion", "alignment", "size", "references"), derived=format_networks)


run = job(study)
