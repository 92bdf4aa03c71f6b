"""Gain against the age of a splat: every snapshot of fits is enhanced and measured, frame by frame and block by block.

    python -m ablations.scripts.convergence WEIGHTS[@STRENGTH][:plain] [...] --runs RUN [RUN ...] --records FILE
        [--lpips FOLDER] [--page FILE]

A run is a folder of the job ``fit`` with several snapshots (``settings.snapshots``). ``:plain`` leaves colour
completion out. Without WEIGHTS the page is made again from the records. Blocks are 16x16 pixels; one is harmed where it
loses more than 0.5 dB.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from ablations.study.enhanced_views import enhanced_views
from ablations.study.markdown import markdown
from ablations.study.plots import STYLE
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.metrics.lpips import PerceptualDistance, perceptual_distance
from gaussian_enhancer.metrics.provenance import this_commit, this_machine
from gaussian_enhancer.scene.renders import read_run, run_steps
from gaussian_enhancer.types import quantised

BLOCK = 16
HARM = 0.5
"""Decibels that a block must lose to count as harmed."""
ROLES = {
    "training": ("conch", "viking", "tumdesk", "panel17", "axe", "caliterra", "lewis", "boruszyn", "office", "buddha"),
    "validation": ("plush", "flowerpot", "cyprus", "banana", "copr"),
    "test": ("fox", "monstree"),
    "procedural": ("object_1000", "outdoor_1000", "unbounded_1000", "indoor_1000"),
}
"""Captures, and procedural validation scenes, by role, as docs/data.md has them."""

TITLES = {
    "training": "Captures that weights may learn from",
    "validation": "Validation captures",
    "test": "Test captures",
    "procedural": "Procedural validation scenes",
}


def blocks(image: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]) -> Float[Tensor, "i j"]:
    """Mean squared error by block."""
    return F.avg_pool2d((image - photo).square().mean(0)[None, None], BLOCK)[0, 0]


def harm(
    render: Float[Tensor, "3 h w"], enhanced: Float[Tensor, "3 h w"], photo: Float[Tensor, "3 h w"]
) -> dict[str, float]:
    """The share of blocks that are harmed, and the squared error removed and added, as shares of the render's."""
    before, after = (blocks(quantised(image), quantised(photo)).clamp_min(1e-7) for image in (render, enhanced))
    harmed = (10 * torch.log10(after / before) > HARM).float().mean()
    removed, added = ((s * (before - after)).clamp_min(0).sum() / before.sum() for s in (1, -1))
    return {"blocks_harmed": float(harmed), "error_removed": float(removed), "error_added": float(added)}


def enhancers(methods: Sequence[str]) -> dict[str, tuple[str, SetEnhancer]]:
    """Digest of the weights and enhancer, by what a method is called.

    Args:
        methods: weights, a strength behind an @, and ":plain" where colour completion is left out.

    Raises:
        InputError: weights cannot be read.
    """
    made = {}
    for method in methods:
        chosen, _, extra = method.partition(":")
        if extra not in ("", "plain"):
            raise InputError(method, f"ends in :{extra}", "leave it out, or write :plain")
        name, _, strength = chosen.partition("@")
        pretrained = load_weights(name)
        share = float(strength) if strength else pretrained.strength
        enhancer = SetEnhancer(
            pretrained.network,
            pretrained.reference_config,
            strength=share,
            pass_through=True,
            colour_completion=not extra,
        )
        made[f"{Path(name).stem}@{share:g}{extra and ' plain'}"] = checkpoint_digest(find_checkpoint(name)), enhancer
    return made


def rows(
    made: Mapping[str, tuple[str, SetEnhancer]], run: Path, distances: Sequence[PerceptualDistance]
) -> Iterator[dict[str, object]]:
    """One row a snapshot, view and method.

    Args:
        made: what `enhancers` returns.
        run: folder of the fit.
        distances: LPIPS distances to measure as well.

    Raises:
        InputError: a view has no photo.
    """
    methods = {method: enhancer for method, (_, enhancer) in made.items()}
    for step in run_steps(run):
        for one in enhanced_views(read_run(run, step), methods, distances):
            raw = {"raw_psnr": one.raw.metrics["psnr"], "raw_psnr_aligned": one.raw.metrics["psnr_aligned"]}
            for method, (digest, _) in made.items():
                where = {"method": method, "weights": digest, "scene": run.name, "step": step, "view": one.view.name}
                gains = {f"gain_{name}": value for name, value in one.gains(method).items()}
                yield {**where, **raw, **gains, **harm(one.render, one.results[method].image, one.photo)}


def role_of(scene: str) -> str:
    """Whether weights may learn from a capture, are chosen by it, or are tested on it.

    Raises:
        InputError: the capture has no role.
    """
    for role, names in ROLES.items():
        if scene in names:
            return role
    raise InputError(scene, "has no role", f"name the run by its capture: {', '.join(sum(ROLES.values(), ()))}")


def summary(frame: pd.DataFrame) -> pd.DataFrame:
    """Means over the views of each capture, snapshot and method, with the worst view."""
    frame = frame.assign(role=frame["scene"].map(role_of))
    groups = frame.groupby(["role", "scene", "step", "method"], sort=True)
    lpips = {
        f"LPIPS({name})": (f"gain_lpips_{name}", "mean")
        for name in ("alex", "squeeze")
        if f"gain_lpips_{name}" in frame
    }
    return groups.agg(
        views=("view", "count"),
        raw=("raw_psnr_aligned", "mean"),
        gain=("gain_psnr_aligned", "mean"),
        worst=("gain_psnr_aligned", "min"),
        plain=("gain_psnr", "mean"),
        worst_plain=("gain_psnr", "min"),
        SSIM=("gain_ssim", "mean"),
        **lpips,
        harmed=("blocks_harmed", "mean"),
        removed=("error_removed", "mean"),
        added=("error_added", "mean"),
    ).reset_index()


def written(frame: pd.DataFrame, picture: str, about: str) -> str:
    """The page as Markdown."""
    table = summary(frame)
    signed = dict.fromkeys(("gain", "worst", "plain", "worst_plain"), "{:+.2f}".format)
    finer = {name: "{:+.4f}".format for name in table.columns if name == "SSIM" or name.startswith("LPIPS")}
    shares = dict.fromkeys(("harmed", "removed", "added"), "{:.1%}".format)
    for name, form in {"raw": "{:.2f}".format, **signed, **finer, **shares}.items():
        table[name] = table[name].map(form)
    heads = {
        "raw": "raw, dB",
        "gain": "gain, dB",
        "worst": "worst view",
        "plain": "gain, plain",
        "worst_plain": "worst view, plain",
        "harmed": f"blocks that lose > {HARM} dB",
        "removed": "error removed",
        "added": "error added",
    }
    parts = ["# Gain against the age of a splat", about, f"![gain against raw PSNR, by capture]({picture})"]
    for role in ROLES:
        mine = table[table["role"] == role].drop(columns="role").rename(columns=heads)
        if len(mine):
            title = TITLES[role]
            parts += [f"## {title}", markdown(mine.astype(str))]
    return "\n\n".join(parts) + "\n"


def drawn(frame: pd.DataFrame, path: Path) -> None:
    """The diagram: mean aligned gain over the raw renders' aligned PSNR, one line a capture, for the first method."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    table = summary(frame)
    table = table[table["method"] == frame["method"].iloc[0]]
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    marks = {"training": "o", "validation": "s", "test": "D", "procedural": "^"}
    for (role, scene), one in table.groupby(["role", "scene"]):
        one = one.sort_values("step")
        axes.plot(one["raw"], one["gain"], marker=marks[role], label=f"{scene} ({role})")
        for _, point in one.iterrows():
            axes.annotate(
                f"{point['step']}", (point["raw"], point["gain"]), fontsize=7, xytext=(3, 3), textcoords="offset points"
            )
    axes.axhline(0, color="grey", linewidth=0.8)
    axes.set(
        xlabel="raw render, colour-aligned PSNR, dB",
        ylabel="gain, dB",
        title=f"{frame['method'].iloc[0]}; points: steps",
    )
    axes.legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    with rc_context({"svg.hashsalt": STYLE["svg.hashsalt"]}):  # equal records give an equal file
        figure.savefig(path, format="svg", metadata={"Date": None})


ABOUT = """Held-out views of real captures, about 400 pixels wide: 3DGS with up to 100,000 Gaussians and spherical
harmonics of degree 3, at several steps of each fit. PSNR is colour-aligned unless it says plain; a gain in LPIPS alone
does not count. Of the training captures, panel17 has taught the shipped weights, the others have not.

`lr_tiny@0.75` is what is shipped: colours are completed, and 75 % of the change is applied. Both were chosen by the
validation captures. `lr_tiny@1 plain` applies the whole change and completes nothing, as versions before did. Rows with
the latter alone are from earlier fits, which are not there any more.

Fits of 3,000 to 10,000 steps have 60,000 to 80,000 Gaussians at most and a fifth of the photos held out
(`settings.max_gaussians`, `scene.split.test_every=5`; `settings.sh_degree=3 +settings.start_gaussians=30000
+densification=gradient +settings.densification.pull=2e-4 +settings.densification.opacity=0.005`); those of fox and
monstree hold out every eighth. The earlier ones are of `gaussian-enhancer fit '+sweep=[converged_training,two_jobs]'`
and `converged_validation`. This page is made by `python -m ablations.scripts.convergence lr_tiny lr_tiny@1:plain
--runs FITS --records docs/results/convergence.jsonl --page docs/results/convergence.md`."""


def main() -> None:
    """Read the command line, enhance, measure, write records and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("methods", nargs="*", metavar="WEIGHTS[@STRENGTH]")
    parser.add_argument("--runs", nargs="*", type=Path, default=[], help="folders of fits")
    parser.add_argument("--records", type=Path, required=True)
    parser.add_argument("--lpips", type=Path, help="folder of LPIPS backbones")
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    torch.set_flush_denormal(True)
    names = ("lpips_alex", "lpips_squeeze") if options.lpips else ()
    distances = [perceptual_distance(name, options.lpips, torch.device("cpu")) for name in names]
    if options.methods:
        provenance = {"commit": this_commit(), "machine": this_machine()}
        made = enhancers(options.methods)
        found = [{**row, **provenance} for run in options.runs for row in rows(made, run, distances)]
        write_text(options.records, pd.DataFrame(found).to_json(orient="records", lines=True))
    frame = pd.read_json(options.records, lines=True)
    if options.page:
        drawn(frame, options.page.with_suffix(".svg"))
        write_text(options.page, written(frame, options.page.with_suffix(".svg").name, ABOUT))
    print(summary(frame).to_string(index=False))


if __name__ == "__main__":
    main()
