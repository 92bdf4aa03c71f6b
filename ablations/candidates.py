"""Which weights to ship: gains of several on the same views of validation runs.

    python ablations/candidates.py WEIGHTS [WEIGHTS ...] --runs RUN [RUN ...] [--every N] [--lpips FOLDER] [--json FILE]

Weights are shipped names or files; a row is named by the shipped name, or by the folder of its training without its
address. Runs must be validation runs (docs/data.md): weights that were chosen on test scenes would be worth nothing.
"""

import argparse
from pathlib import Path

import torch
from renders import measured, table

from gaussian_enhancer.enhance.enhancer import Enhancer
from gaussian_enhancer.enhance.weights import load_weights
from gaussian_enhancer.errors import InputError


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
    print(table(measured(made, options.runs, options.lpips, options.json, options.every), "weights"))


if __name__ == "__main__":
    main()
