"""How far a reference may differ from the render: gains on validation runs by the limit of `Reprojected.agreement`.

    python ablations/agreement.py WEIGHTS RUN [RUN ...] [--every N] [--json FILE]

Runs must be validation runs (docs/data.md).
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path

import torch
from renders import gains, table

from gaussian_enhancer.enhance.enhancer import Enhancer
from gaussian_enhancer.enhance.weights import Pretrained, load_weights

LIMITS = (None, 0.3, 0.2, 0.15, 0.1)


def enhancers(pretrained: Pretrained) -> dict[str, Enhancer]:
    """The same network at full strength with references checked to each limit."""
    made = {}
    for limit in LIMITS:
        warp = replace(pretrained.preparation.warp, agreement=limit)
        made[str(limit)] = Enhancer(pretrained.network, replace(pretrained.preparation, warp=warp))
    return made


def main() -> None:
    """Read the command line, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--every", type=int, default=8, help="every n-th held-out view")
    parser.add_argument("--json", type=Path, help="write every row there")
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    made = enhancers(load_weights(options.weights))
    rows = [row for run in options.runs for row in gains(made, run, [], options.every)]
    print(table(rows, "agreement"))
    if options.json:
        options.json.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


if __name__ == "__main__":
    main()
