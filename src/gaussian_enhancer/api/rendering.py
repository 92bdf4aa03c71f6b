"""Rendering a splat from Python."""

from collections.abc import Sequence

from gaussian_enhancer.api.images import Array, read_background
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.splat.methods import Method, choose_method
from gaussian_enhancer.splat.render import render as render_gaussians
from gaussian_enhancer.types import Camera, Gaussians, Render


def render(
    splat: Gaussians,
    camera: Camera,
    method: str | Method = "auto",
    background: Sequence[int | float] | Array = (0.0, 0.0, 0.0),
    near: int | float = 0.01,
) -> Render:
    """Render a splat; the result is differentiable with respect to the splat's tensors.

    On the CPU it uses this project's rasteriser, on CUDA gsplat (``pip install gaussian-enhancer[cuda]``).

    Args:
        splat: the Gaussians, for instance from `read_splat`.
        camera: the camera; it determines the image's size.
        method: "3dgs", "2dgs", "mip_splatting", or "auto" for the method that the splat was fitted with
            (`choose_method`).
        background: background colour, three numbers in [0, 1] or an array of them.
        near: near plane: smallest rendered z, in scene units.

    Returns:
        ``colour`` (3, h, w), not clamped; ``depth`` and ``median_depth`` (1, h, w), z in scene units; ``alpha``
        (1, h, w); ``surface``, the depth for enhancement with ``depth_kind="surface"``.

    Raises:
        InputError: the method is unknown or does not suit the splat, the camera cannot be used, or the background is no
            colour.

    Example:
        >>> import torch
        >>> splat = Gaussians(
        ...     torch.tensor([[0.0, 0.0, 2.0]]), torch.full((1, 3), -2.0), torch.tensor([[1.0, 0, 0, 0]]),
        ...     torch.tensor([4.0]), torch.zeros(1, 1, 3),
        ... )
        >>> camera = Camera.from_matrices([[20, 0, 8], [0, 20, 8], [0, 0, 1]], torch.eye(4), 16, 16)
        >>> render(splat, camera).colour.shape
        torch.Size([3, 16, 16])
    """
    if not isinstance(camera, Camera):
        remedy = "give gaussian_enhancer.Camera.from_matrices(K, world_to_camera, height, width)"
        raise InputError("camera", f"is of type {type(camera).__name__}", remedy)
    rendering_method = choose_method(method, splat) if isinstance(method, str) else method
    colour = read_background(background)
    return render_gaussians(splat, camera.to(splat.means.device), rendering_method, colour, near=float(near))
