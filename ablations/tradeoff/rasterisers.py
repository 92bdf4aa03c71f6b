"""The rasterisers of the numerics study: forward and backward by kernels and by a reference, compared with float64.

Axes: n Gaussians, h height, w width.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from ablations.tradeoff.kernels import DTYPES, Cases
from gaussian_enhancer.splat.methods import METHODS, Method, MipSplatting, TwoDGS
from gaussian_enhancer.splat.oracle import render_oracle
from gaussian_enhancer.splat.render import render
from gaussian_enhancer.types import Camera, Gaussians, Render, identity_camera

Draw = Callable[[Gaussians, Camera, Method], Render]

COUNT, FEW = 200, (48, 64)
"""Number of Gaussians, and height and width of the image; small, as the reference evaluates all at every pixel."""


def rasterisers(device: torch.device) -> Cases:
    """Forward and backward of 3DGS, Mip-Splatting and 2DGS: kernels (gsplat on CUDA), and a reference in PyTorch."""
    for method in (METHODS[name] for name in ("3dgs", "mip_splatting", "2dgs")):
        splat = _cloud(2 if isinstance(method, TwoDGS) else 3, isinstance(method, MipSplatting)).to(device)
        camera = identity_camera(*FEW, float(FEW[1])).to(device)
        for name, compute in (("forward", _rendered_image), ("backward", _parameter_gradients)):
            kernel = "kernels" if device.type == "cpu" else "gsplat"
            calls = {f"{kernel}/float32": partial(compute, render, splat.to(torch.float32), camera, method)}
            for dtype in DTYPES:
                calls[f"plain twin/{dtype}"] = partial(compute, render_oracle, splat.to(DTYPES[dtype]), camera, method)
            reference = partial(compute, render_oracle, splat.to(torch.float64), camera, method)
            yield f"{method.name}, {name}", reference, calls


def _cloud(axes: int, smoothed: bool) -> Gaussians:
    """Random Gaussians in front of a camera at the origin: anisotropic, of mixed opacity, SH degree 1."""
    generator = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator, dtype=torch.float64)

    means = normal(COUNT, 3) * torch.tensor([0.8, 0.6, 0.6]) + torch.tensor([0.0, 0.0, 4.0])
    scales, quaternions, opacities = 0.5 * normal(COUNT, axes) + math.log(0.08), normal(COUNT, 4), normal(COUNT)
    smoothing = torch.full((COUNT,), 0.01, dtype=torch.float64) if smoothed else None
    return Gaussians(means, scales, quaternions, opacities, 0.3 * normal(COUNT, 4, 3), smoothing)


def _rendered_image(draw: Draw, splat: Gaussians, camera: Camera, method: Method) -> Tensor:
    """Colour and opacity of one view."""
    with torch.no_grad():
        rendered = draw(splat, camera.to(splat.means.dtype), method)
    return torch.cat([rendered.colour, rendered.alpha])


def _parameter_gradients(draw: Draw, splat: Gaussians, camera: Camera, method: Method) -> Tensor:
    """The gradient of the view's summed squared colours with respect to all parameters of the splat."""
    names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    leaves = {name: getattr(splat, name).detach().requires_grad_() for name in names}
    rendered = draw(replace(splat, **leaves), camera.to(splat.means.dtype), method)
    rendered.colour.square().sum().backward()
    return torch.cat([leaf.grad.double().flatten() for leaf in leaves.values() if leaf.grad is not None])
