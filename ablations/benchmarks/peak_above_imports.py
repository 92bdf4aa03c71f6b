"""Peak memory of one enhancement or of one network, above what its process held after all imports.

Each measurement runs in a separate process. The process first makes the call at a small size, so that imports, compiled
code and caches of libraries do not count.
"""

import gc
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import psutil
import torch
from hydra import initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from ablations.benchmarks.peer_networks import built, enhancement, forward
from ablations.benchmarks.synthetic_views import read_views
from ablations.study.cost import peak_memory
from gaussian_enhancer import memory
from gaussian_enhancer.configurations import configurations
from gaussian_enhancer.runs.instantiate import plain_values
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
    return _alone(cfg, partial(_forward, name, dtype), (SMALL, SMALL), (cfg.height, cfg.width))


def enhancement_peak(cfg: DictConfig, name: str, dtype: str, folder: Path, small: Path) -> float:
    """Megabytes of an enhancement: weights, decoded images, alignment, network.

    Args:
        cfg: conf/peers.yaml, composed.
        name: of the network, one of ours.
        dtype: in which it computes, or "auto".
        folder: of the views (`write_views`).
        small: of views for the first, uncounted call.
    """
    return _alone(cfg, partial(_enhance, name, dtype), small, folder)


def _forward(name: str, dtype: str, cfg: DictConfig, device: torch.device, size: tuple[int, int]) -> None:
    forward(built(cfg, name, device), dtype, *size, cfg.references)()


def _enhance(name: str, dtype: str, cfg: DictConfig, device: torch.device, views: Path) -> None:
    enhancement(built(cfg, name, device), dtype, read_views(views), device)()


def _alone(cfg: DictConfig, call: Callable[..., None], small: Any, whole: Any) -> float:
    """Megabytes of a call on the whole input, in a separate process, after a call on the small input."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_measured, plain_values(cfg), call, small, whole).result()


def _measured(values: dict[str, Any], call: Callable[..., None], small: Any, whole: Any) -> float:
    cfg = OmegaConf.create(values)
    device = start(cfg.runtime)
    with initialize_config_dir(str(configurations()), version_base="1.3"):
        call(cfg, device, small)
        return _above(lambda: call(cfg, device, whole), device)


def _above(call: Callable[[], None], device: torch.device) -> float:
    """Peak megabytes of a call, minus the memory in use before it."""
    gc.collect()
    memory.release_freed_memory()
    in_use = 0 if device.type == "cuda" else psutil.Process().memory_info().rss
    return (peak_memory(call, device) - in_use) / 1e6
