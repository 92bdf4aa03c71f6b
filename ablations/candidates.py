"""Which weights to ship: gains of several on the same views of validation runs.

    python ablations/candidates.py WEIGHTS [WEIGHTS ...] --runs RUN [RUN ...] [--every N] [--lpips FOLDER] [--json FILE]

Weights are shipped names or files; a row is named by the shipped name, or by the folder of its training without its
address. Runs must be validation runs (docs/data.md): weights that were chosen on test scenes would be worth nothing.
"""

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path

import torch
from renders import gains, table

from gaussian_enhancer.enhance.enhancer import Enhancer
from gaussian_enhancer.enhance.weights import load_weights
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.measure.perceptual import perceptual_distance
from gaussian_enhancer.measure.provenance import this_commit, this_machine
from gaussian_enhancer.measure.realism import finished_runs


def name_of(weights: str) -> str:
    """What a row is called."""
    path = Path(weights)
    return path.parent.name.rpartition("-")[0] or path.stem if path.suffix else weights


def enhancers(candidates: list[str]) -> dict[str, Enhancer]:
    """Each candidate as the job enhance would use it.

    Raises:
        InputError: two have the same name, or one enlarges its renders.
    """
    made: dict[str, Enhancer] = {}
    for weights in candidates:
        found, name = load_weights(weights), name_of(weights)
        if name in made:
            raise InputError(weights, f"is the second row {name}", "label trainings differently")
        if found.network.scale != 1:
            raise InputError(weights, f"enlarges {found.network.scale} times", "give weights of the render's own size")
        made[name] = Enhancer(found.network, found.preparation, strength=found.strength)
    return made


def main() -> None:
    """Read the command line, enhance, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", nargs="+")
    parser.add_argument("--runs", nargs="+", required=True, help="folders of finished fits, or patterns")
    parser.add_argument("--every", type=int, default=1, help="every n-th held-out view")
    parser.add_argument("--lpips", type=Path, help="folder of LPIPS backbones")
    parser.add_argument("--json", type=Path, help="write every row there")
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    made = enhancers(options.weights)
    distances = [perceptual_distance("lpips_alex", options.lpips, torch.device("cpu"))] if options.lpips else []
    provenance = {"commit": this_commit(), "machine": this_machine()}
    rows: list[dict] = []
    for run in finished_runs(options.runs)[0]:
        now = datetime.now(UTC).isoformat(timespec="seconds")
        rows += [{**found, **provenance, "time": now} for found in gains(made, run, distances, options.every)]
        if options.json:
            options.json.write_text("".join(json.dumps(one) + "\n" for one in rows), encoding="utf-8")
    print(table(rows, "weights"))


if __name__ == "__main__":
    main()
