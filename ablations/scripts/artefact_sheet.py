"""``gaussian-enhancer artefact_sheet``: each type of artefact beside a real crop of the same kind, at pixel size.

For types that represent an error of splats, the real crop is the one with most of that error among the held-out renders
of the runs, all snapshots. The simulated crops show the same place of the same photo at rising strengths, for the one
of several draws that changes the crop most. Types that represent none of the six errors have no real crop. The table
compares quantiles, over all crops, of the error that a type represents. Runs must be training runs (docs/data.md), of
captures whose licence permits showing them.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from ablations.realism.real_crops import KINDS, Crop, crops, cut, energies_of, worst
from ablations.realism.realism import RealRender, photographed, real_renders
from ablations.study.engine import Study, job
from ablations.study.fits import finished_fits, scene_of
from ablations.study.processor import refuse_gpu
from gaussian_enhancer.degrade.artefact_types import ARTEFACTS, TYPES
from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.fingerprint import ENERGIES
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.report.figures import contact_sheet
from gaussian_enhancer.scene.frozen import refuse_untrained

STRENGTHS = (0.25, 0.5, 1.0)
QUANTILES = (0.5, 0.95, 0.99)


def simulate_strengths(view: View, name: str, strengths: Sequence[float], seed: int) -> list[Float[Tensor, "3 h w"]]:
    """A view with one type of artefact at rising strengths, all with the same random draw."""
    copies = view[torch.zeros(len(strengths), dtype=torch.int64)]
    generators = [torch.Generator().manual_seed(seed) for _ in strengths]
    with torch.no_grad():
        degraded = ARTEFACTS[name](copies, view.image.new_tensor(strengths), generators)
    return list(degraded.image.clamp(0, 1))


def plainest_crop(view: View, crop: Crop, name: str, side: int, draws: int) -> list[Tensor]:
    """Crops at rising strengths, for the draw that changes this place most."""
    before = cut(view.image[0], crop.place, (side, side))

    def change(seed: int) -> float:
        return float(
            (cut(simulate_strengths(view, name, (1.0,), seed)[0], crop.place, (side, side)) - before).square().mean()
        )

    chosen = max(range(draws), key=change)
    return [cut(image, crop.place, (side, side)) for image in simulate_strengths(view, name, STRENGTHS, chosen)]


def sheet_row(
    reals: Sequence[RealRender], real_crops: Sequence[Crop], name: str, side: int, draws: int
) -> tuple[list[Tensor], str]:
    """A row of the sheet, and what stands under it."""
    kind = KINDS.get(name)
    crop = worst(real_crops, kind or "anisotropy")
    real = reals[crop.view]
    assert real.target.read is not None
    view = photographed(real)
    photo = cut(view.image[0], crop.place, (side, side))
    render = cut(real.target.read(), crop.place, (side, side)) if kind else torch.full_like(photo, 0.98)
    label = f"real: {kind}" if kind else "its error is not measured"
    return [photo, render, *plainest_crop(view, crop, name, side, draws)], f"{name} ({real.scene}); {label}"


def simulated_energies(reals: Sequence[RealRender], name: str, side: int, seeds: int) -> Float[Tensor, "n 6"]:
    """Error energies of every crop of the same views, with a type of artefact at full strength.

    Args:
        reals: real renders, whose photos, depths and opacities are degraded.
        name: the type.
        side: of a crop, pixels.
        seeds: draws of each view.
    """
    views = [photographed(real) for real in reals]
    pairs = [
        (simulate_strengths(view, name, (1.0,), 1000 * number + seed)[0], view.image[0])
        for number, view in enumerate(views)
        for seed in range(seeds)
    ]
    return energies_of(crops(pairs, (side, side)))


def sheet_metrics(name: str, real: Tensor, simulated: Tensor) -> dict[str, object]:
    """Amplitudes (roots of an energy, in 1/255) of real and simulated crops at some quantiles.

    Args:
        name: type of artefact.
        real: energies of real crops, (n, 6).
        simulated: energies of crops at full strength, (m, 6).
    """
    index = ENERGIES.index(KINDS[name])
    levels = real.new_tensor(QUANTILES)
    amplitudes = [255 * values[:, index].quantile(levels).sqrt() for values in (real, simulated)]
    keys = [f"{side}_{share:g}" for side in ("real", "simulated") for share in QUANTILES]
    values = torch.cat(amplitudes).tolist()
    return {"type": name, "energy": KINDS[name], **dict(zip(keys, values, strict=True))}


def write_sheet(reals: Sequence[RealRender], real_crops: Sequence[Crop], path: Path, side: int, draws: int) -> None:
    """Write the sheet.

    Args:
        reals: real renders.
        real_crops: their crops.
        path: PNG or JPEG.
        side: of a crop, pixels.
        draws: of each type, of which the one that changes the crop most is shown.

    Raises:
        InputError: the file cannot be written.
    """
    order = (*KINDS, *sorted({*TYPES} - {*KINDS}))
    images, names = zip(*(sheet_row(reals, real_crops, name, side, draws) for name in order), strict=True)
    titles = ("photo", "real render", *(f"strength {strength:g}" for strength in STRENGTHS))
    with atomic_write(path) as temporary:
        kind = "PNG" if path.suffix == ".png" else "JPEG"
        contact_sheet(images, titles, names, height=side).save(temporary, kind, quality=93, subsampling=0)


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """Amplitudes of every type that represents an error of splats; on request, also the sheet.

    Raises:
        InputError: runs cannot be used or are of scenes that nothing may be trained on, or a file cannot be written.
    """
    refuse_gpu(device)
    fits = finished_fits(cfg.runs)
    refuse_untrained(fits)
    reals = real_renders(fits, cfg.renders, 0)
    pairs = [(real.target.read(), photographed(real).image[0]) for real in reals if real.target.read is not None]
    real_crops = crops(pairs, (cfg.side, cfg.side))
    if cfg.picture:
        write_sheet(reals, real_crops, Path(cfg.picture), cfg.side, cfg.draws)
    energies = energies_of(real_crops)
    source = {"scenes": sorted({scene_of(fit) for fit in fits}), "crops": len(real_crops)}

    def measure(name: str) -> Iterator[dict[str, object]]:
        yield sheet_metrics(name, energies, simulated_energies(reals, name, cfg.side, cfg.seeds)) | source

    named = {f"{side}_{share:g}": f"{side} {100 * share:g} %" for side in ("real", "simulated") for share in QUANTILES}
    return Study(tuple(KINDS), measure, ("type",), derived=lambda frame: frame.rename(columns=named))


run = job(study)
