"""What the diffusion's sampler keeps of the codes of real renders, by steps and kind of sampling.

    python -m ablations.scripts.sampler RUN [RUN ...] [--generator WEIGHTS] [--json FILE]

On crops of held-out views, all snapshots: spread of sampled codes over that of the extractor's (1 is right), root mean
square change L - G over that of real renders R - G, and milliseconds. Stage 1 is the gate calibrated on the renders of
the view itself, so that what is left to see is stage 2. Runs must be validation runs (docs/data.md).
"""

import argparse
import json
import time
from pathlib import Path

import torch

from ablations.realism.realism import finished_runs, real_renders
from gaussian_enhancer.degrade.artefacts.rng import spawn
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.adaptive import calibrated
from gaussian_enhancer.degrade.gates.fingerprint import fingerprint
from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.weights import load_model
from gaussian_enhancer.degrade.simulator import Simulator
from gaussian_enhancer.metrics.provenance import this_commit, this_machine

SAMPLERS = {
    **{f"DDIM, {steps} steps": Sampler(steps) for steps in (1, 2, 4, 8, 16)},
    **{f"ancestral, {steps} steps": Sampler(steps, noise=1.0) for steps in (1, 2, 4, 8, 16)},
    "posterior mean, 4 steps": Sampler(4, mean=True),
}


def main() -> None:
    """Read the command line, sample, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", help="folders of finished fits, or patterns")
    parser.add_argument("--generator", default="simulator", help="weights of stage 2")
    parser.add_argument("--renders", type=int, default=32)
    parser.add_argument("--json", type=Path, help="write a line for every sampler there")
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    views = [one.target for one in real_renders(finished_runs(options.runs)[0], options.renders)]
    photo, real = (torch.stack([read()[:, :128, :128] for read in reads]) for reads in zip(*_reads(views), strict=True))
    gate = calibrated(
        fingerprint(list(real), list(photo)), list(photo[:4]), torch.Generator().manual_seed(0), held_out={}
    )
    manual = Simulator(gate)(View(photo), torch.Generator().manual_seed(0)).image
    model = load_model(options.generator).model
    rows = []
    with torch.no_grad():
        true = model.extractor(manual, real).grid.std((0, 2, 3))
        for name, sampler in SAMPLERS.items():
            begun = time.perf_counter()
            codes = model.sample(manual, sampler, spawn(len(manual), torch.Generator().manual_seed(1)))
            seconds = time.perf_counter() - begun
            made = model.combine(manual, codes, spawn(len(manual), torch.Generator().manual_seed(2))).clamp(0, 1)
            change = [float((image - photo).square().mean().sqrt()) for image in (made, real)]
            spread = float((codes.grid.std((0, 2, 3)) / true).mean())
            row = {"sampler": name, "spread": spread, "change": change[0] / change[1]}
            rows.append({**row, "milliseconds": 1e3 * seconds / len(manual), "views": len(manual)})
    print("| sampler | spread of codes | change of the view | ms a crop of 128 x 128 |\n|---|---|---|---|")
    for row in rows:
        print(f"| {row['sampler']} | {row['spread']:.2f} | {row['change']:.2f} | {row['milliseconds']:.1f} |")
    if options.json:
        where = {"commit": this_commit(), "machine": this_machine()}
        options.json.write_text("".join(json.dumps({**row, **where}) + "\n" for row in rows), encoding="utf-8")


def _reads(views: list) -> list[tuple]:
    return [(view.read_photo, view.read) for view in views]


if __name__ == "__main__":
    main()
