"""Input of the simulator: a photo from a file, or a held-out view of a fitted run.

Axes: h height, w width.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.depth_files import ReadDepth
from gaussian_enhancer.scene.photos import background_colour, read_header
from gaussian_enhancer.scene.posed import ReadCoverage, ReadPhoto
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.types import Movable


@dataclass(frozen=True)
class SimulatorInput(Movable):
    """Input of the simulator: one photo with its depth and opacity.

    Args:
        name: short name, used for folders.
        view: the photo with depth and opacity, as a batch of one.
        real: the splat's render of the same view; None if there is none.
        origin: description of where each part comes from.
    """

    name: str
    view: View
    real: Float[Tensor, "1 3 h w"] | None = None
    origin: Mapping[str, str] = field(default_factory=dict)


def read_image(
    image: str | Path,
    depth: str | Path | None = None,
    *,
    depth_scale: float | int = 1.0,
    background: Sequence[object] = (0.0, 0.0, 0.0),
) -> SimulatorInput:
    """Read a photo from a file, and its depth from another file.

    Args:
        image: image file of 8 or 16 bits per channel. An alpha channel is kept as opacity, and colours are composited
            over the background, as in renders.
        depth: file of z depth of the same size; None if unknown.
        depth_scale: scene units per stored unit of depth.
        background: colour under transparent parts.

    Raises:
        InputError: a file is missing or damaged, its pixel format has no defined white, sizes differ, the background is
            no colour, or the scale is not positive.
    """
    colour = background_colour(background)
    if not isinstance(depth_scale, int | float) or not depth_scale > 0:
        raise InputError("depth_scale", f"is {depth_scale!r}", "give a positive number")
    path = Path(image)
    header = read_header(path)
    size = header.height, header.width
    photo = ReadPhoto(path, *size, colour)()
    alpha = ReadCoverage(path, *size)() if header.has_alpha else None
    z = ReadDepth(Path(depth), float(depth_scale))() if depth is not None else None
    if z is not None and tuple(z.shape[1:]) != size:
        received = f"is {z.shape[2]}x{z.shape[1]} but {path.name} is {size[1]}x{size[0]}"
        raise InputError(depth, received, "bring both to the same size")
    alpha_origin = f"from the alpha channel; colours laid over {colour}"
    origin = {
        "Photo": str(path),
        "Depth": "unknown" if depth is None else f"{depth}, times {depth_scale:g}",
        "Opacity": "unknown" if alpha is None else alpha_origin,
    }
    return SimulatorInput(path.stem, _view(photo, z, alpha), origin=origin)


def read_held_out(rendered: RenderedSet, name: str | None = None) -> SimulatorInput:
    """The photo of a held-out view of a splat, with the rendered depth, opacity and colours of the same view.

    Args:
        rendered: the splat's renders.
        name: the view's file name, with or without ending; None takes the first view.

    Raises:
        InputError: there is no such view, or it has no photo.
    """
    target = next((v for v in rendered.targets if name in (None, v.name, Path(v.name).stem)), None)
    if target is None:
        names = _format_names([view.name for view in rendered.targets])
        raise InputError("view", f"is {name!r}, which {rendered.name} does not hold out", f"choose {names}")
    if target.read is None or target.read_photo is None:
        raise InputError(f"{rendered.name}, {target.name}", "has no photo beside its render", "name a run that kept gt")
    depth, alpha = (None if read is None else read() for read in (target.read_depth, target.read_alpha))
    origin = {
        "Run": rendered.name,
        "Photo": f"held-out view {target.name}",
        "Depth": "unknown" if depth is None else "rendered",
        "Opacity": "unknown" if alpha is None else "rendered",
    }
    label = f"{rendered.name}-{Path(target.name).stem}"
    return SimulatorInput(label, _view(target.read_photo(), depth, alpha), target.read()[None], origin)


def _view(photo: Tensor, depth: Tensor | None, alpha: Tensor | None) -> View:
    return View(photo[None], *(None if plane is None else plane[None] for plane in (depth, alpha)))


def _format_names(names: Sequence[str]) -> str:
    """The first 8 names, for an error message."""
    return ", ".join(names[:8]) + (f" or another of {len(names)}" if len(names) > 8 else "")
