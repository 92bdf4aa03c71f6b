"""How much simulated renders look like real ones: can a classifier tell them apart, and what separates them?

    python -m ablations.scripts.realism --train RUN [RUN ...] --test RUN [RUN ...]
        [--rows naive all random adaptive tsds] [--generator WEIGHTS] [--steps 8] [--seeds 3] [--json FILE]

Real renders are the held-out views of finished runs, all snapshots; each row simulates the same views from their
photos. The classifier learns on scenes of --train and is judged on scenes of --test, all rows on the same patches.
While a simulator is developed both are validation scenes (docs/data.md); the final test is on test scenes, with
validation scenes to train the classifier, since the simulator has never seen either.
"""

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

import torch

from ablations.realism.patches import cut_patches
from ablations.realism.realism import (
    RealRender,
    Row,
    distances,
    finished_runs,
    real_renders,
    simulated_pairs,
)
from ablations.realism.two_sample import TwoSample, two_sample_test
from ablations.scripts.simulators import rows
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.metrics.provenance import this_commit, this_machine

SHOWN = ("accuracy", "interval", "auc", "beside photo", "spectrum dB", "residual dB", "anisotropy", "residual", "PSNR")


def compared(name: str, row: Row, train: list[RealRender], test: list[RealRender], options: argparse.Namespace) -> dict:
    """Simulate the views of both sides by one row and compare them with the real renders.

    Args:
        name: the row's name.
        row: how its simulators are made.
        train: real renders whose views the classifier learns from.
        test: real renders of other scenes.
        options: seeds, patch size and number of patches from the command line.
    """
    begun, worked = time.perf_counter(), time.process_time()
    learn = cut_patches(simulated_pairs(train, row, options.seed), options.size, options.patches, options.seed)
    pairs = list(simulated_pairs(test, row, options.seed + 1))
    judge = cut_patches(pairs, options.size, options.patches, options.seed + 1)
    simulated = time.perf_counter()
    found: dict[str, object] = {"row": name, "seed": options.seed, "size": options.size}
    for subject, conditional in (("alone", False), ("beside_photo", True)):
        result = two_sample_test(learn, judge, conditional=conditional, seeds=options.seeds, first_seed=options.seed)
        found[subject] = dataclasses.asdict(result)
    found |= {"train_patches": 2 * len(learn), "train_views": len(learn.views), "train_scenes": learn.scenes}
    found |= {"test_scenes": judge.scenes, "test_renders": len(pairs)}
    found["distances"] = distances(pairs)
    elapsed = {"simulation": simulated - begun, "tests": time.perf_counter() - simulated}
    found["seconds"] = {**elapsed, "processor": time.process_time() - worked}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {**found, "commit": this_commit(), "machine": this_machine(), "time": now}


def table(results: list[dict]) -> str:
    """One line a row, as Markdown."""
    lines = ["| row | " + " | ".join(SHOWN) + " |", "|---" * (len(SHOWN) + 1) + "|"]
    for result in results:
        alone, beside, far = TwoSample(**result["alone"]), TwoSample(**result["beside_photo"]), result["distances"]
        cells = (
            f"{100 * alone.accuracy:.1f}%",
            f"{100 * alone.low:.1f}-{100 * alone.high:.1f}%",
            f"{alone.auc:.3f}",
            f"{100 * beside.accuracy:.1f}%",
            f"{far['spectrum_image_db']:.2f}",
            f"{far['spectrum_residual_db']:.2f}",
            f"{far['anisotropy_image']:.3f}",
            f"{far['anisotropy_residual']:.3f}",
            f"{far['psnr_simulated_db']:.2f} ({far['psnr_real_db']:.2f})",
        )
        lines.append(f"| {result['row']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def chosen(patterns: list[str], most: int | None, seed: int) -> list[RealRender]:
    """Real renders of the finished runs that patterns name; says which runs are not finished."""
    runs, unfinished = finished_runs(patterns)
    for run in unfinished:
        print(f"{run}: not finished, left out", file=sys.stderr)
    return real_renders(runs, most, seed)


def studied(makers: Mapping[str, Row], compare: Callable[[str, Row], dict], path: Path | None) -> list[dict]:
    """Compare row by row; what is done so far is written after each row, so that a kill loses one at most.

    Args:
        makers: rows by name.
        compare: gives a row's result.
        path: file that gets a line for every row; None writes none.
    """
    results: list[dict] = []
    for name, row in makers.items():
        results.append(compare(name, row))
        print(json.dumps(results[-1]), file=sys.stderr)
        if path:
            with whole_file(path) as temporary:
                temporary.write_text("".join(json.dumps(one) + "\n" for one in results), encoding="utf-8")
    return results


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--train", nargs="+", required=True, help="runs of the classifier's training scenes")
    parser.add_argument("--test", nargs="+", required=True, help="runs of the scenes it is judged on")
    parser.add_argument("--rows", nargs="+", default=["naive", "all", "random"], help="simulators to compare")
    parser.add_argument("--generator", help="weights of stage 2, for the row tsds")
    parser.add_argument("--steps", type=int, default=8, help="of the diffusion's sampler")
    parser.add_argument("--seeds", type=int, default=3, help="number of classifiers")
    parser.add_argument("--seed", type=int, default=0, help="of views, patches, simulation and first classifier")
    parser.add_argument("--renders", type=int, default=300, help="real renders on each side at most")
    parser.add_argument("--patches", type=int, default=6, help="patches of a render at most")
    parser.add_argument("--size", type=int, default=64, help="side of a patch in pixels")
    parser.add_argument("--json", type=Path, help="write a line for every row there")
    return parser.parse_args()


def main() -> None:
    """Compare row by row; write and print."""
    options = arguments()
    torch.set_flush_denormal(True)
    makers = rows(options.rows, options.generator, options.steps)
    train, test = (chosen(side, options.renders, options.seed) for side in (options.train, options.test))
    shared = {one.scene for one in train} & {one.scene for one in test}
    if shared:
        raise InputError("--test", f"shares the scene {sorted(shared)[0]} with --train", "keep the scenes apart")
    print(table(studied(makers, lambda name, row: compared(name, row, train, test, options), options.json)))


if __name__ == "__main__":
    main()
