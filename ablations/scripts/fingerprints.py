"""How much larger the errors of held-out views are than those of the views that a splat was fitted to, by energy.

    python -m ablations.scripts.fingerprints RUN [RUN ...] [--views N] [--json FILE] [--gates FOLDER]

For every run and snapshot it measures the fingerprint of the training views and that of the held-out views. The line
fitted to both in the logarithms is what `gaussian_enhancer.degrade.gates.adaptive.HELD_OUT` states. ``--gates`` also
calibrates a gate on the held-out views of each snapshot and writes it there: with ``gate=adaptive
'gate.file=FOLDER/*.json'`` they are stage 1 of the second stage's training. Runs must be training runs (docs/data.md).
"""

import argparse
import json
import math
import statistics
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from gaussian_enhancer.degrade.gates.adaptive import calibrated
from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES, Fingerprint, fingerprint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.scene.renders import read_run, run_steps

Images = list[Tensor]


def spread(views: Sequence[RenderedView], count: int) -> tuple[Images, Images]:
    """Renders and photos of at most so many views, evenly spaced."""
    chosen = [views[i * len(views) // count] for i in range(count)] if len(views) > count else list(views)
    renders, photos = [], []
    for view in chosen:
        if view.read is None or view.read_photo is None:
            raise InputError(view.name, "has no render or no photo", "give runs with both, training views included")
        renders.append(view.read())
        photos.append(view.read_photo())
    return renders, photos


def measured(views: Sequence[RenderedView], count: int) -> Fingerprint:
    """The fingerprint of at most so many views, evenly spaced."""
    return fingerprint(*spread(views, count))


def calibrate(run: Path, folder: Path, count: int, photographs: int = 3) -> None:
    """Write a gate for each snapshot of a run, calibrated on its held-out views."""
    for step in run_steps(run):
        targets = read_run(run, step).targets
        photos = spread(targets, photographs)[1]
        generator = torch.Generator().manual_seed(0)
        # Held-out views are measured themselves, so that nothing has to be made up for.
        gate = calibrated(measured(targets, count), photos, generator, held_out={}, draws=1)
        gate.to_file(folder / f"{run.name}-{step}.json")


def rows(run: Path, count: int) -> list[dict[str, object]]:
    """One record for each of a run's snapshots: energies of both sides and their ratios."""
    found = []
    if not run_steps(run):
        raise InputError(run, "holds no renders of held-out views", "name folders of finished fits")
    for step in run_steps(run):
        rendered = read_run(run, step)
        seen, unseen = measured(rendered.references, count), measured(rendered.targets, count)
        record: dict[str, object] = {"run": run.name, "step": step, "last": step == run_steps(run)[-1]}
        record |= {"training_views": seen.views, "held_out_views": unseen.views}
        for name in ENERGIES:
            before, after = getattr(seen, name), getattr(unseen, name)
            record[name] = {"training": before, "held_out": after, "ratio": after / before if before > 0 else None}
        found.append(record)
    return found


def table(records: Sequence[dict]) -> str:
    """Ratios of held-out to training views' energies at each run's last step; factor and power over all snapshots."""
    last = [record for record in records if record["last"]]
    heads = ("energy", f"ratio, n = {len(last)}", "least", "most", f"factor, n = {len(records)}", "power")
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name in ENERGIES:
        ratios = [record[name]["held_out"] / record[name]["training"] for record in last if record[name]["training"]]
        factor, power = growth([(record[name]["training"], record[name]["held_out"]) for record in records])
        numbers = (statistics.median(ratios), min(ratios), max(ratios), factor, power)
        lines.append(f"| {name} | {' | '.join(f'{number:.2f}' for number in numbers)} |")
    return "\n".join(lines)


def growth(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Factor and power of held-out energies as a function of training views': least squares in the logarithms."""
    known = [(math.log(before), math.log(after)) for before, after in pairs if before > 0 and after > 0]
    power, logarithm = statistics.linear_regression(*zip(*known, strict=True))
    return math.exp(logarithm), power


def main() -> None:
    """Read the command line, measure, print; write what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--views", type=int, default=8, help="of each side, evenly spaced")
    parser.add_argument("--json", type=Path, help="write every record there")
    parser.add_argument("--gates", type=Path, help="calibrate a gate on each snapshot and write it there")
    options = parser.parse_args()
    records = []
    for run in options.runs:
        records += rows(run, options.views)
        if options.json:
            options.json.write_text("".join(json.dumps(record) + "\n" for record in records), encoding="utf-8")
        if options.gates:
            calibrate(run, options.gates, options.views)
    print(table(records))


if __name__ == "__main__":
    main()
