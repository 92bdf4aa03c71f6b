"""``gaussian-enhancer realism``: can a classifier tell simulated renders from real ones?

The job also measures distances between them. Real renders are the held-out views of finished runs, all snapshots; each
row simulates the same views from their photos. The classifier is trained on scenes of ``train`` and tested on scenes of
``test``, for all rows on the same patches. During development of a simulator, both are validation scenes
(docs/data.md). The final test is on test scenes, with a classifier trained on validation scenes; the simulator has
learned from neither. Test scenes are refused for the classifier's training side.
"""

import dataclasses
import json
import sys
import time
from collections.abc import Sequence

import torch
from omegaconf import DictConfig

from ablations.realism.patches import cut_patches
from ablations.realism.realism import RealRender, Row, distances, real_renders, simulated_pairs
from ablations.realism.simulators import rows
from ablations.realism.two_sample import two_sample_test
from ablations.study.engine import Study, job
from ablations.study.fits import finished_runs, refuse_frozen_fits
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.errors import InputError


def compared(name: str, row: Row, train: list[RealRender], test: list[RealRender], cfg: DictConfig) -> dict:
    """Simulate the views of both sides by one row and compare them with the real renders.

    Args:
        name: the row's name.
        row: how its simulators are made.
        train: real renders whose views the classifier learns from.
        test: real renders of other scenes.
        cfg: conf/realism.yaml, composed.
    """
    started, worked = time.perf_counter(), time.process_time()
    train_patches = cut_patches(simulated_pairs(train, row, cfg.seed), cfg.patch_size, cfg.patches, cfg.seed)
    pairs = list(simulated_pairs(test, row, cfg.seed + 1))
    test_patches = cut_patches(pairs, cfg.patch_size, cfg.patches, cfg.seed + 1)
    simulated = time.perf_counter()
    row_values: dict[str, object] = {"row": name, "seed": cfg.seed, "size": cfg.patch_size}
    for subject, conditional in (("alone", False), ("beside_photo", True)):
        options = {"conditional": conditional, "seeds": cfg.seeds, "first_seed": cfg.seed}
        row_values[subject] = dataclasses.asdict(two_sample_test(train_patches, test_patches, **options))
    row_values |= {"train_patches": 2 * len(train_patches), "train_views": len(train_patches.views)}
    row_values |= {"train_scenes": train_patches.scenes, "test_scenes": test_patches.scenes, "test_renders": len(pairs)}
    row_values["distances"] = distances(pairs)
    elapsed = {"simulation": simulated - started, "tests": time.perf_counter() - simulated}
    row_values["seconds"] = {**elapsed, "processor": time.process_time() - worked}
    return row_values


def chosen(patterns: Sequence[str], count: int | None, seed: int) -> list[RealRender]:
    """Real renders of the finished runs that patterns name; prints which runs are not finished."""
    runs, unfinished = finished_runs(patterns)
    for run in unfinished:
        print(f"{run}: not finished, left out", file=sys.stderr)
    return real_renders(runs, count, seed)


def print_row(row: dict) -> dict:
    """Print a row as soon as it is measured, since rows take long."""
    print(json.dumps(row), file=sys.stderr)
    return row


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """Every row against the real renders.

    Raises:
        InputError: a row is unknown, runs cannot be used or share a scene, or a run of ``train`` is of a test scene.
    """
    refuse_gpu(device)
    makers = rows(cfg.rows, cfg.generator_weights, cfg.steps)
    refuse_frozen_fits(finished_runs(cfg.train)[0], "trained on")
    train, test = (chosen(side, cfg.renders, cfg.seed) for side in (cfg.train, cfg.test))
    shared = {render.scene for render in train} & {render.scene for render in test}
    if shared:
        raise InputError("test", f"shares the scene {sorted(shared)[0]} with train", "keep the scenes apart")

    def measure(name: str) -> list[dict]:
        return [print_row(compared(name, makers[name], train, test, cfg))]

    return Study(tuple(makers), measure, ("row", "seed", "size"), option="rows")


run = job(study)
