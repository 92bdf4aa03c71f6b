"""The kernels of the numerics study: each computation in float64, and by every implementation and dtype.

Each function yields cases. A call of a case is one implementation in one dtype.
Inputs are drawn once, in float64, and converted to the dtype of each call: errors contain those of the rounded inputs,
of the arithmetic and of the method.

Axes: c channels, h height, w width.
"""

import copy
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from ablations.suite.costs import plane
from gaussian_enhancer.align.depth_search import Source, refine_depth
from gaussian_enhancer.align.depth_smoothing import smooth_depth
from gaussian_enhancer.align.references import ReferencePool, build_network_input, read_target
from gaussian_enhancer.align.reproject import reproject
from gaussian_enhancer.degrade.artefacts.blur import oriented_kernels
from gaussian_enhancer.degrade.artefacts.downsampling import KINDS, resampling_matrix
from gaussian_enhancer.degrade.generative.diffusion import CosineSchedule, LinearSchedule, Sampler, Schedule
from gaussian_enhancer.degrade.generative.factors import Factors, grid_size
from gaussian_enhancer.degrade.generative.weights import load_model
from gaussian_enhancer.infer.weights import load_weights
from gaussian_enhancer.network.deform import deformable_sample
from gaussian_enhancer.types import quantise_8_bit

Case = tuple[str, Callable[[], Tensor], Mapping[str, Callable[[], Tensor]]]
"""What is computed, the same in float64, and calls by "implementation/dtype" (or another varied option)."""
Cases = Iterator[Case]

DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
SIZE = (96, 128)
"""Height and width of images."""

FINEST, SIDE = 512, 64
"""Steps of the latent sampler's reference solution, and side of its crop."""


def deformable(device: torch.device) -> Cases:
    """Modulated deformable sampling: ours by grid_sample, and torchvision's operator, which is also the reference."""
    from torchvision.ops import deform_conv2d

    generator, (height, width) = torch.Generator().manual_seed(0), SIZE
    shapes = (1, 32, height, width), (1, 72, height, width), (1, 36, height, width), (32, 32, 3, 3)
    x, offset, mask, weight = (
        torch.randn(shape, generator=generator, dtype=torch.float64).to(device) for shape in shapes
    )
    offset, mask, weight = 3 * offset, mask.sigmoid(), weight / 17

    def ours(dtype: torch.dtype) -> Tensor:
        return deformable_sample(*(tensor.to(dtype) for tensor in (x, offset, mask, weight)))

    def theirs(dtype: torch.dtype) -> Tensor:
        x_, offset_, mask_, weight_ = (tensor.to(dtype) for tensor in (x, offset, mask, weight))
        return deform_conv2d(x_, offset_, weight_, padding=1, mask=mask_)

    calls = {f"grid_sample/{name}": partial(ours, dtype) for name, dtype in DTYPES.items()}
    calls |= {f"torchvision/{name}": partial(theirs, dtype) for name, dtype in DTYPES.items()}
    yield "deformable sampling", partial(theirs, torch.float64), calls


def reprojection(device: torch.device) -> Cases:
    """Warping a photo through depth, smoothing depth, and refining depth: each by compiled kernels and by tensors.

    Inputs in half precision are computed in single precision.
    """
    views = plane(*SIZE)
    target, source = views.targets[0], views.references[0]
    photo, depth = source.read_photo, target.read_depth
    if photo is None or depth is None or target.camera is None or source.camera is None or target.read is None:
        raise RuntimeError("a plane has photos, depth and cameras")
    cameras = [camera.to(device) for camera in (target.camera, source.camera)]
    inputs = [read().double().to(device) for read in (depth, photo)]

    def warped(dtype: torch.dtype, precise: torch.dtype, tensors: bool = False) -> Tensor:
        target_camera, source_camera = (camera.to(precise) for camera in cameras)
        z, image = (tensor.to(dtype) for tensor in inputs)
        # The compiled kernels have no backward pass: inputs that require a gradient are computed by tensors.
        return reproject(target_camera, z.requires_grad_(tensors), source_camera, image).colour.detach()

    calls = {f"grid_sample/{name}": partial(warped, dtype, torch.float32, True) for name, dtype in DTYPES.items()}
    if device.type == "cpu":
        calls |= {f"compiled/{name}": partial(warped, dtype, torch.float32) for name, dtype in DTYPES.items()}
    yield "reprojection", partial(warped, torch.float64, torch.float64), calls
    generator = torch.Generator().manual_seed(0)
    rough = inputs[0] * (1 + 0.01 * torch.randn(inputs[0].shape, generator=generator, dtype=torch.float64).to(device))

    def smoothed(dtype: torch.dtype, tensors: bool = False) -> Tensor:
        return smooth_depth(rough.to(dtype).requires_grad_(tensors), inputs[1].to(dtype)).detach()

    calls = {"tensors/float32": partial(smoothed, torch.float32, True)}
    if device.type == "cpu":
        calls["compiled/float32"] = partial(smoothed, torch.float32)
    yield "smoothing of depth", partial(smoothed, torch.float64), calls
    image = target.read().double().to(device)
    others = [view for view in views.references if view.camera is not None]
    photos = [photo().double().to(device) for view in others if (photo := view.read_photo) is not None]
    all_cameras = [cameras[0], *(view.camera.to(device) for view in others if view.camera is not None)]

    def searched(dtype: torch.dtype, tensors: bool = False) -> Tensor:
        target_camera, *source_cameras = (camera.to(dtype) for camera in all_cameras)
        z, render, *cast_photos = (tensor.to(dtype) for tensor in (rough, image, *photos))
        sources = [Source(*source) for source in zip(source_cameras, cast_photos, strict=True)]
        return refine_depth(target_camera, z.requires_grad_(tensors), render, sources, smooth=False).detach()

    calls = {"tensors/float32": partial(searched, torch.float32, True)}
    if device.type == "cpu":
        calls["compiled/float32"] = partial(searched, torch.float32)
    yield "search of depth", partial(searched, torch.float64), calls


def resampling(device: torch.device) -> Cases:
    """Resizing by matrices and by interpolation, and blur by convolution and by Fourier transform."""
    generator, (height, width) = torch.Generator().manual_seed(0), SIZE
    image = torch.rand(1, 3, height, width, generator=generator, dtype=torch.float64).to(device)
    factor, phase = (torch.full((1,), value, dtype=torch.float64, device=device) for value in (2.3, 0.2))
    down, up = (torch.tensor([KINDS.index(kind)], device=device) for kind in ("bilinear", "bicubic"))

    def by_matrix(dtype: torch.dtype, positions: torch.dtype) -> Tensor:
        resampling_options = factor.to(positions), phase.to(positions), down, up
        rows, columns = (resampling_matrix(side, *resampling_options).to(dtype) for side in (height, width))
        return rows @ image.to(dtype) @ columns.mT

    calls = {f"positions in float64/{name}": partial(by_matrix, dtype, torch.float64) for name, dtype in DTYPES.items()}
    calls["positions in float32/float32"] = partial(by_matrix, torch.float32, torch.float32)
    yield "resize, down and up", partial(by_matrix, torch.float64, torch.float64), calls

    def larger(dtype: torch.dtype) -> Tensor:
        return F.interpolate(image.to(dtype), scale_factor=4, mode="bicubic", align_corners=False)

    calls = {f"interpolate/{name}": partial(larger, dtype) for name, dtype in DTYPES.items()}
    yield "enlarge 4 times", partial(larger, torch.float64), calls
    shape = (torch.full((1, 1), value, dtype=torch.float64, device=device) for value in (2.0, 0.8, 0.5))
    kernel = oriented_kernels(*shape)[0]
    side = kernel.shape[-1]
    padded = F.pad(image, [side // 2] * 4, mode="replicate")

    def convolved(dtype: torch.dtype) -> Tensor:
        return F.conv2d(padded.to(dtype), kernel.to(dtype).expand(3, 1, side, side), groups=3)

    def transformed(dtype: torch.dtype) -> Tensor:
        size = tuple(padded.shape[-2:])
        spectra = (torch.fft.rfft2(tensor.to(dtype), s=size) for tensor in (padded, kernel.flip(-1, -2)))
        product = math.prod(spectra, start=torch.ones((), device=device))
        return torch.fft.irfft2(product, s=size)[..., side - 1 :, side - 1 :]

    calls = {f"convolution/{name}": partial(convolved, dtype) for name, dtype in DTYPES.items()}
    calls["Fourier/float32"] = partial(transformed, torch.float32)
    yield "blur", partial(convolved, torch.float64), calls


def latent(device: torch.device) -> Cases:
    """The latent sampler by number and spacing of steps, against a solution of the same equation in 512 steps."""
    model = load_model("simulator").model.eval().requires_grad_(False).to(device)
    generator = torch.Generator().manual_seed(0)
    image = F.interpolate(
        torch.rand(1, 3, 16, 16, generator=generator, dtype=torch.float64), size=(SIDE, SIDE), mode="bicubic"
    )
    rows, columns = grid_size(SIDE, SIDE)
    sizes = (1, model.design.vector), (1, model.design.grid, rows, columns)
    initial_noise = Factors(*(torch.randn(size, generator=generator, dtype=torch.float64).to(device) for size in sizes))
    cosine_schedule, manual = CosineSchedule(), image.clamp(0, 1).to(device)
    models = {
        dtype: copy.deepcopy(model.denoiser).to(dtype) for dtype in (torch.float64, torch.float32, torch.bfloat16)
    }

    def sampled(dtype: torch.dtype, schedule: Schedule, steps: int) -> Tensor:
        features = models[dtype].features(manual.to(dtype))

        def predict(noisy: Factors, time: Tensor) -> Factors:
            # The network takes times of its own (cosine) schedule: pass the one at which that has the same signal.
            signal = schedule.signal(time.double()).clamp(-1, 1)
            network_time: Tensor = (
                time
                if isinstance(schedule, CosineSchedule)
                else torch.acos(signal) * 2 / (math.pi * cosine_schedule.end)
            )
            return models[dtype](noisy, network_time.to(dtype), features)

        factors = Sampler(steps)(predict, initial_noise.to(dtype), schedule, ())
        return torch.cat([factors.vector.flatten(), factors.grid.flatten()])

    calls = {f"cosine/{n} steps": partial(sampled, torch.float32, cosine_schedule, n) for n in (1, 2, 4, 8, 16, 32)}
    calls |= {f"linear/{n} steps": partial(sampled, torch.float32, LinearSchedule(), n) for n in (1, 2, 4, 8, 16, 32)}
    calls |= {f"cosine in bfloat16/{n} steps": partial(sampled, torch.bfloat16, cosine_schedule, n) for n in (4, 8, 16)}
    calls["cosine in float64/256 steps"] = partial(sampled, torch.float64, cosine_schedule, FINEST // 2)
    yield "latent sampler", partial(sampled, torch.float64, cosine_schedule, FINEST), calls


def networks(device: torch.device) -> Cases:
    """The shipped network on aligned references, with autocast to each dtype."""
    pretrained = load_weights("lr_tiny")
    network = pretrained.network.requires_grad_(False).to(device)
    views = plane(*SIZE)
    target = read_target(views.targets[0])
    aligned = pretrained.reference_config.align(target, views.targets[0], ReferencePool(views.references))
    inputs = build_network_input(replace(target, image=quantise_8_bit(target.image)), aligned).to(device)
    precise, exact = copy.deepcopy(network).double(), inputs.to(torch.float64)

    def enhanced(dtype: torch.dtype) -> Tensor:
        with torch.inference_mode(), torch.autocast(device.type, dtype, enabled=dtype != torch.float32):
            result: Tensor = network(inputs)
        return result

    calls = {f"autocast/{dtype}": partial(enhanced, DTYPES[dtype]) for dtype in DTYPES}
    yield "network lr_tiny", partial(precise, exact), calls
