"""``gaussian-enhancer realism``: how much simulated renders look like real ones.

Can a classifier tell them apart, and what separates them? Real renders are the held-out views of finished runs, all
snapshots; each row simulates the same views from their photos. The classifier learns on scenes of ``train`` and is
judged on scenes of ``test``, all rows on the same patches. While a simulator is developed both are validation scenes
(docs/data.md); the final test is on test scenes, with validation scenes to train the classifier, since the simulator
has never seen either.
"""

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence

from omegaconf import DictConfig

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
from ablations.study.markdown import frame, markdown
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json_lines
from gaussian_enhancer.metrics.provenance import provenance
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.runtime import start

SHOWN = ("accuracy", "interval", "auc", "beside photo", "spectrum dB", "residual dB", "anisotropy", "residual", "PSNR")


def compared(name: str, row: Row, train: list[RealRender], test: list[RealRender], cfg: DictConfig) -> dict:
    """Simulate the views of both sides by one row and compare them with the real renders.

    Args:
        name: the row's name.
        row: how its simulators are made.
        train: real renders whose views the classifier learns from.
        test: real renders of other scenes.
        cfg: conf/realism.yaml, composed.
    """
    begun, worked = time.perf_counter(), time.process_time()
    learn = cut_patches(simulated_pairs(train, row, cfg.seed), cfg.patch_size, cfg.patches, cfg.seed)
    pairs = list(simulated_pairs(test, row, cfg.seed + 1))
    judge = cut_patches(pairs, cfg.patch_size, cfg.patches, cfg.seed + 1)
    simulated = time.perf_counter()
    found: dict[str, object] = {"row": name, "seed": cfg.seed, "size": cfg.patch_size}
    for subject, conditional in (("alone", False), ("beside_photo", True)):
        result = two_sample_test(learn, judge, conditional=conditional, seeds=cfg.seeds, first_seed=cfg.seed)
        found[subject] = dataclasses.asdict(result)
    found |= {"train_patches": 2 * len(learn), "train_views": len(learn.views), "train_scenes": learn.scenes}
    found |= {"test_scenes": judge.scenes, "test_renders": len(pairs)}
    found["distances"] = distances(pairs)
    elapsed = {"simulation": simulated - begun, "tests": time.perf_counter() - simulated}
    found["seconds"] = {**elapsed, "processor": time.process_time() - worked}
    return {**found, **provenance(timed=True)}


def table(results: list[dict]) -> str:
    """One line a row, as Markdown."""
    lines = []
    for result in results:
        alone, beside, far = TwoSample(**result["alone"]), TwoSample(**result["beside_photo"]), result["distances"]
        cells = (
            result["row"],
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
        lines.append(cells)
    return markdown(frame(("row", *SHOWN), lines))


def chosen(patterns: Sequence[str], most: int | None, seed: int) -> list[RealRender]:
    """Real renders of the finished runs that patterns name; says which runs are not finished."""
    runs, unfinished = finished_runs(patterns)
    for run in unfinished:
        print(f"{run}: not finished, left out", file=sys.stderr)
    return real_renders(runs, most, seed)


def studied(makers: Mapping[str, Row], compare: Callable[[str, Row], dict], path: str | None) -> list[dict]:
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
            write_json_lines(path, results)
    return results


def run(cfg: DictConfig) -> None:
    """Compare row by row; write and print.

    Args:
        cfg: conf/realism.yaml, composed.

    Raises:
        InputError: a row is unknown, runs cannot be used or share a scene, or the records cannot be written.
    """
    require(cfg)
    start(cfg.runtime)
    makers = rows(cfg.rows, cfg.generator_weights, cfg.steps)
    train, test = (chosen(side, cfg.renders, cfg.seed) for side in (cfg.train, cfg.test))
    shared = {one.scene for one in train} & {one.scene for one in test}
    if shared:
        raise InputError("test", f"shares the scene {sorted(shared)[0]} with train", "keep the scenes apart")
    print(table(studied(makers, lambda name, row: compared(name, row, train, test, cfg), cfg.records)), end="")
