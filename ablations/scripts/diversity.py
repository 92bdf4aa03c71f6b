"""How much simulated renders of one view differ from seed to seed, against real renders of it from fit to fit.

    python -m ablations.scripts.diversity RUN [RUN ...] [--rows naive all random adaptive tsds] [--generator WEIGHTS]
        [--json FILE]

Real renders of a view come from runs of the same scene: other methods, training views, snapshots. Each of them has a
simulated counterpart with a seed of its own, so that both spreads are over as many samples. A simulator whose spread
is far below the real one has collapsed.
"""

import argparse
import statistics
from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path

import torch

from ablations.realism.diversity import diversity
from ablations.realism.patches import RenderPair
from ablations.realism.realism import RealRender, Row, simulated_pairs
from ablations.scripts.realism import chosen, studied
from ablations.scripts.simulators import rows
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.provenance import this_commit, this_machine


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
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {**found, "commit": this_commit(), "machine": this_machine(), "time": now}


def table(results: list[dict]) -> str:
    """One line a row, as Markdown; spreads in steps of 1/255."""
    lines = ["| row | simulated spread | real spread | share | views | renders |", "|---" * 6 + "|"]
    for result in results:
        simulated, real = result["simulated"]["mean"], result["real"]["mean"]
        share = f"{simulated / real:.2f}" if real > 0 else "real renders are equal"
        cells = (f"{255 * simulated:.2f}", f"{255 * real:.2f}", share, str(result["views"]), str(result["renders"]))
        lines.append(f"| {result['row']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Read the command line, compare row by row, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--rows", nargs="+", default=["naive", "all", "random"], help="simulators to compare")
    parser.add_argument("--generator", help="weights of stage 2, for the row tsds")
    parser.add_argument("--seed", type=int, default=0, help="of the simulation")
    parser.add_argument("--json", type=Path, help="write a line for every row there")
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    makers, reals = rows(options.rows, options.generator), chosen(options.runs, None, options.seed)
    print(table(studied(makers, lambda name, row: compared(name, row, reals, options.seed), options.json)))


if __name__ == "__main__":
    main()
