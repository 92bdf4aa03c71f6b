"""``gaussian-enhancer diversity``: spread of simulated renders of one view over seeds.

It is compared with the spread of real renders of the view, which come from runs of the same scene with other methods,
training views or snapshots. Each real render has a simulated counterpart with its own seed, so both spreads are over
the same number of samples. A simulator whose spread is far below the real one has collapsed.

Axes: n samples, c channels, h height, w width.
"""

import statistics
from collections import defaultdict

import pandas as pd
import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from ablations.realism.patches import RenderPair
from ablations.realism.realism import RealRender, Row, simulated_pairs
from ablations.realism.simulators import rows
from ablations.scripts.realism import chosen, print_row
from ablations.study.engine import Study, job
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.errors import InputError


def diversity(samples: Float[Tensor, "n c h w"]) -> float:
    """Mean over pixels and channels of the standard deviation (ddof 1) over samples.

    Renders and their differences from the photo have the same diversity. The estimate grows slightly with n, so compare
    only sets with the same number of samples.

    Args:
        samples: renders of one view, simulated with several seeds or fitted in several ways.

    Raises:
        InputError: there is a single sample.
    """
    if len(samples) < 2:
        raise InputError("samples", f"has {len(samples)}", "give at least two of the same view")
    return samples.double().std(dim=0, correction=1).mean().item()


def same_views(pairs: list[RenderPair]) -> list[list[RenderPair]]:
    """Pairs grouped by scene, view and size; groups of one have no spread and are left out.

    Raises:
        InputError: no view has two renders.
    """
    groups: dict[tuple[object, ...], list[RenderPair]] = defaultdict(list)
    for pair in pairs:
        groups[pair.scene, pair.view, *pair.photo.shape].append(pair)
    kept = [group for group in groups.values() if len(group) >= 2]
    if not kept:
        raise InputError("runs", "contain no view with 2 renders", "name several runs of one scene")
    return kept


def compared(name: str, row: Row, reals: list[RealRender], seed: int) -> dict:
    """Mean spreads of one row and of the real renders over the same views.

    Args:
        name: the row's name.
        row: how its simulators are made.
        reals: real renders.
        seed: of the simulation.
    """
    groups = same_views(list(simulated_pairs(reals, row, seed)))
    spreads = {
        kind: [diversity(torch.stack([getattr(pair, kind) for pair in group]) / 255) for group in groups]
        for kind in ("simulated", "real")
    }
    result: dict[str, object] = {"row": name, "seed": seed, "views": len(groups), "renders": sum(map(len, groups))}
    for kind, values in spreads.items():
        deviation = statistics.stdev(values) if len(values) > 1 else None
        result[kind] = {"mean": statistics.fmean(values), "deviation": deviation, "n": len(values)}
    return result


def spreads(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows with spreads in steps of 1/255, and the simulated one as a share of the real one."""
    simulated, real = 255 * frame["simulated mean"], 255 * frame["real mean"]
    share = (simulated / real).where(real > 0)
    return frame.assign(**{"simulated spread": simulated, "real spread": real, "share": share})


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """Every row's spread and the real one.

    Raises:
        InputError: a row is unknown, or runs cannot be used.
    """
    refuse_gpu(device)
    makers, reals = rows(cfg.rows, cfg.generator_weights), chosen(cfg.runs, None, cfg.seed)

    def measure(name: str) -> list[dict]:
        return [print_row(compared(name, makers[name], reals, cfg.seed))]

    return Study(tuple(makers), measure, ("row", "seed"), derived=spreads, option="rows")


run = job(study)
