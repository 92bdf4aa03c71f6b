"""Peak memory of one enhancement or of one network, above what its process held after all imports.

Each measurement has a process of its own. It does everything once at a small size first, so that what is imported,
compiled or kept by libraries on first use does not count.
"""

import gc
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import psutil
import torch
from hydra import initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from ablations.benchmarks.peer_networks import built, enhancement, forward
from ablations.benchmarks.synthetic_views import read_views
from gaussian_enhancer import memory
from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.metrics.cost import peak_memory
from gaussian_enhancer.runs.instantiate import plain
from gaussian_enhancer.runs.runtime import start

SMALL = 64
"""Side of the input of the first, uncounted call of a network."""


def network_peak(cfg: DictConfig, name: str, dtype: str) -> float:
    """Megabytes of a network's weights, input and forward pass.

    Args:
        cfg: conf/peers.yaml, composed.
        name: of the network.
        dtype: in which it computes.
    """
    return _alone(_network_peak, plain(cfg), name, dtype)


def enhancement_peak(cfg: DictConfig, name: str, dtype: str, folder: Path, small: Path) -> float:
    """Megabytes of an enhancement: weights, decoded images, alignment, network.

    Args:
        cfg: conf/peers.yaml, composed.
        name: of the network, one of ours.
        dtype: in which it computes, or "auto".
        folder: of the views (`write_views`).
        small: of views for the first, uncounted call.
    """
    return _alone(_enhancement_peak, plain(cfg), name, dtype, folder, small)


def _alone(measure: Callable[..., float], *arguments: Any) -> float:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(measure, *arguments).result()


def _network_peak(values: dict[str, Any], name: str, dtype: str) -> float:
    cfg = OmegaConf.create(values)
    device = start(cfg.runtime)

    def call(height: int, width: int) -> None:
        forward(built(cfg, name, device), dtype, height, width, cfg.references)()

    with initialize_config_dir(str(configurations()), version_base="1.3"):
        call(SMALL, SMALL)
        return _above(lambda: call(cfg.height, cfg.width), device)


def _enhancement_peak(values: dict[str, Any], name: str, dtype: str, folder: Path, small: Path) -> float:
    cfg = OmegaConf.create(values)
    device = start(cfg.runtime)

    def call(views: Path) -> None:
        enhancement(built(cfg, name, device), dtype, read_views(views), device)()

    with initialize_config_dir(str(configurations()), version_base="1.3"):
        call(small)
        return _above(lambda: call(folder), device)


def _above(call: Callable[[], None], device: torch.device) -> float:
    """Megabytes that a call takes at its peak, above what is held before it."""
    gc.collect()
    memory.give_back()
    held = 0 if device.type == "cuda" else psutil.Process().memory_info().rss
    return (peak_memory(call, device) - held) / 1e6
