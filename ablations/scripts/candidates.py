"""Which weights to ship: gains of several on the same views of validation runs.

    python -m ablations.scripts.candidates WEIGHTS [WEIGHTS ...] --runs RUN [RUN ...] [--every N]
        [--lpips FOLDER] [--json FILE]

Weights are shipped names or files; a row is named by the shipped name, or by the folder of its training without its
address. Runs must be validation runs (docs/data.md): weights that were chosen on test scenes would be worth nothing.
"""

import argparse
import glob
from pathlib import Path

import torch

from ablations.scripts.renders import measured, table
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.scene.frozen import refuse_frozen


def name_of(weights: str) -> str:
    """What a row is called."""
    path = Path(weights)
    return path.parent.name.rpartition("-")[0] or path.stem if path.suffix else weights


def loaded(candidates: list[str]) -> dict[str, Pretrained]:
    """Each candidate by what its row is called.

    Raises:
        InputError: two have the same name, or one enlarges its renders.
    """
    made: dict[str, Pretrained] = {}
    for weights in candidates:
        found, name = load_weights(weights), name_of(weights)
        if name in made:
            raise InputError(weights, f"is the second row {name}", "label trainings differently")
        if found.network.scale != 1:
            raise InputError(weights, f"enlarges {found.network.scale} times", "give weights of the render's own size")
        made[name] = found
    return made


def enhancers(candidates: list[str]) -> dict[str, SetEnhancer]:
    """Each candidate as the job enhance would use it; see `loaded` for what is refused."""
    return {
        name: SetEnhancer(found.network, found.reference_config, strength=found.strength)
        for name, found in loaded(candidates).items()
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which weights are measured, on what, and where the rows go."""
    parser.add_argument("weights", nargs="+")
    parser.add_argument("--runs", nargs="+", required=True, help="folders of finished fits, or patterns")
    parser.add_argument("--every", type=int, default=1, help="every n-th held-out view")
    parser.add_argument("--lpips", type=Path, help="folder of LPIPS backbones")
    parser.add_argument("--json", type=Path, help="write every row there")


def show(made: dict[str, SetEnhancer], options: argparse.Namespace, head: str) -> None:
    """Enhance, measure, print a line for each row under a head.

    Raises:
        InputError: a run is of a test scene, by which nothing may be chosen.
    """
    found = [path for pattern in options.runs for path in sorted(glob.glob(str(pattern))) or [pattern]]
    refuse_frozen(found, "chosen by")
    torch.set_flush_denormal(True)
    print(table(measured(made, options.runs, options.lpips, options.json, options.every), head))


def main() -> None:
    """Read the command line, enhance, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    options = parser.parse_args()
    show(enhancers(options.weights), options, "weights")


if __name__ == "__main__":
    main()
