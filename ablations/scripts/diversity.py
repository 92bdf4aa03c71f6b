"""``gaussian-enhancer diversity``: how much simulated renders of one view differ from seed to seed.

They are held against real renders of it from fit to fit, which come from runs of the same scene: other methods,
training views, snapshots. Each of them has a simulated counterpart with a seed of its own, so that both spreads are
over as many samples. A simulator whose spread is far below the real one has collapsed.
"""

import statistics
from collections import defaultdict

import torch
from omegaconf import DictConfig

from ablations.realism.diversity import diversity
from ablations.realism.patches import RenderPair
from ablations.realism.realism import RealRender, Row, simulated_pairs
from ablations.scripts.realism import chosen, studied
from ablations.scripts.simulators import rows
from ablations.study.markdown import frame, markdown
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.provenance import provenance
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.runtime import start


def same_views(pairs: list[RenderPair], least: int = 2) -> list[list[RenderPair]]:
    """Pairs grouped by scene, view and size; groups of fewer than ``least`` have no spread and are left out.

    Raises:
        InputError: no view has so many renders.
    """
    groups: dict[tuple[object, ...], list[RenderPair]] = defaultdict(list)
    for pair in pairs:
        groups[pair.scene, pair.view, *pair.photo.shape].append(pair)
    kept = [group for group in groups.values() if len(group) >= least]
    if not kept:
        raise InputError("runs", f"hold no view with {least} renders", "name several runs of one scene")
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
    found: dict[str, object] = {"row": name, "seed": seed, "views": len(groups), "renders": sum(map(len, groups))}
    for kind, values in spreads.items():
        deviation = statistics.stdev(values) if len(values) > 1 else None
        found[kind] = {"mean": statistics.fmean(values), "deviation": deviation, "n": len(values)}
    return {**found, **provenance(timed=True)}


def table(results: list[dict]) -> str:
    """One line a row, as Markdown; spreads in steps of 1/255."""
    lines = []
    for result in results:
        simulated, real = result["simulated"]["mean"], result["real"]["mean"]
        share = f"{simulated / real:.2f}" if real > 0 else "real renders are equal"
        spreads = (f"{255 * simulated:.2f}", f"{255 * real:.2f}", share)
        lines.append((result["row"], *spreads, str(result["views"]), str(result["renders"])))
    return markdown(frame(("row", "simulated spread", "real spread", "share", "views", "renders"), lines))


def run(cfg: DictConfig) -> None:
    """Compare row by row; write and print.

    Args:
        cfg: conf/diversity.yaml, composed.

    Raises:
        InputError: a row is unknown, runs cannot be used, or the records cannot be written.
    """
    require(cfg)
    start(cfg.runtime)
    makers, reals = rows(cfg.rows, cfg.generator_weights), chosen(cfg.runs, None, cfg.seed)
    print(table(studied(makers, lambda name, row: compared(name, row, reals, cfg.seed), cfg.records)), end="")
