"""Data types that the stages exchange: cameras, Gaussians, renders and the network's input.

Axes: b batch, h height, w width, n Gaussians, k spherical-harmonics coefficients (1, 4, 9 or 16),
s scale axes (3 for ellipsoids, 2 for disks), r references. Images are float in [0, 1], sRGB, channels first.
Cameras are pinhole with OpenCV axes (x right, y down, z forward); the first pixel's centre is at (0.5, 0.5).
Depth is z in scene units, and 0 where no surface was hit.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gaussian_enhancer.errors import InputError

_M = TypeVar("_M", bound="Movable")
MAX_POSE_VALUE = 1e9
"""Largest value of a pose in scene units; float32 has a spacing of 64 units there."""


class Movable:
    """Frozen dataclass whose tensors, also nested ones, move together; Lightning calls ``.to(device)``."""

    def to(self: _M, *args: Any, **kwargs: Any) -> _M:
        """Return a copy with every tensor moved as `torch.Tensor.to` would move it."""

        def move(value: Any) -> Any:
            if isinstance(value, Tensor | Movable):
                return value.to(*args, **kwargs)
            return value

        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return dataclasses.replace(self, **{f.name: move(getattr(self, f.name)) for f in fields})  # type: ignore[type-var]


@dataclass(frozen=True)
class Region:
    """A rectangle of pixels; ``bottom`` and ``right`` are exclusive."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def area(self) -> int:
        """Number of pixels."""
        return (self.bottom - self.top) * (self.right - self.left)

    def expand(self, margin: int, height: int, width: int) -> "Region":
        """The region with a margin on every side, clipped to the image."""
        top, left = max(0, self.top - margin), max(0, self.left - margin)
        return Region(top, left, min(height, self.bottom + margin), min(width, self.right + margin))

    def relative_to(self, outer: "Region") -> "Region":
        """The same region in the coordinates of a larger region that contains it."""
        return Region(self.top - outer.top, self.left - outer.left, self.bottom - outer.top, self.right - outer.left)

    def crop(self, image: Tensor, scale: int = 1) -> Tensor:
        """Crop an image (..., scale height, scale width) to the region."""
        rows, columns = (slice(scale * a, scale * b) for a, b in ((self.top, self.bottom), (self.left, self.right)))
        return image[..., rows, columns]


@dataclass(frozen=True)
class Camera(Movable):
    """A pinhole camera: its intrinsics, its pose and the size of its image.

    `from_matrices` builds one from numpy arrays, tensors or lists and checks them.

    Args:
        K: intrinsics in pixels, last row (0, 0, 1).
        world_to_camera: rigid transform from world to OpenCV camera axes.
        height: image height in pixels.
        width: image width in pixels.
    """

    K: Float[Tensor, "3 3"]
    world_to_camera: Float[Tensor, "4 4"]
    height: int
    width: int

    @classmethod
    def from_matrices(cls, K: Any, world_to_camera: Any, height: int, width: int) -> "Camera":
        """Build a camera from its matrices, in OpenCV's convention: x right, y down, z forward.

        A camera-to-world matrix must be inverted first (``np.linalg.inv``). A matrix in the convention of OpenGL or
        Blender, as in nerfstudio and NeRF-Synthetic, must first be multiplied from the right by
        ``np.diag([1, -1, -1, 1])``.

        Args:
            K: intrinsics in pixels (fx, 0, cx; 0, fy, cy; 0, 0, 1), shape (3, 3). The first pixel's centre is at
                (0.5, 0.5), so that the middle of the image is at (width / 2, height / 2).
            world_to_camera: rigid transform from the world to the camera, shape (4, 4) or (3, 4), in scene units.
            height: image height in pixels.
            width: image width in pixels.

        Raises:
            InputError: a shape is wrong, a value is not finite, a focal length or a size is not positive, or the
                transform is not rigid.

        Example:
            >>> camera = Camera.from_matrices([[50, 0, 32], [0, 50, 24], [0, 0, 1]], torch.eye(4), 48, 64)
            >>> camera.centre.tolist()
            [0.0, 0.0, 0.0]
        """
        intrinsics, pose = _matrix("camera K", K, (3, 3)), _matrix("camera pose", world_to_camera, (4, 4), (3, 4))
        if not (int(height) == height > 0 and int(width) == width > 0):
            raise InputError("camera", f"has an image of {width}x{height}", "give height and width in pixels, above 0")
        if not bool(torch.isfinite(intrinsics).all()) or not (intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0):
            raise InputError("camera K", f"is {intrinsics.tolist()}", "give finite values and focal lengths above 0")
        if intrinsics[2].tolist() != [0, 0, 1]:
            raise InputError("camera K", f"has the last row {intrinsics[2].tolist()}", "give (0, 0, 1)")
        if pose.shape[0] == 3:
            pose = torch.cat([pose, pose.new_tensor([[0, 0, 0, 1]])])
        if not torch.allclose(pose[3], pose.new_tensor([0, 0, 0, 1]), atol=1e-6):
            raise InputError("camera pose", f"has the last row {pose[3].tolist()}", "give (0, 0, 0, 1)")
        return cls(intrinsics.float(), orthonormal_pose(pose, "camera").float(), int(height), int(width))

    @property
    def rotation(self) -> Float[Tensor, "3 3"]:
        """World-to-camera rotation."""
        return self.world_to_camera[:3, :3]

    @property
    def centre(self) -> Float[Tensor, " 3"]:
        """The camera's position in the world."""
        return -self.rotation.T @ self.world_to_camera[:3, 3]

    @property
    def forward(self) -> Float[Tensor, " 3"]:
        """Unit viewing direction in the world."""
        return self.rotation[2]

    def crop(self, region: "Region") -> "Camera":
        """The camera of a region of the image: the principal point is shifted by the region's corner."""
        K = self.K.clone()
        K[0, 2] -= region.left
        K[1, 2] -= region.top
        return dataclasses.replace(self, K=K, height=region.bottom - region.top, width=region.right - region.left)

    def resized(self, height: int, width: int) -> "Camera":
        """The camera with another image size and the same field of view."""
        scale = self.K.new_tensor([[width / self.width], [height / self.height], [1.0]])
        return dataclasses.replace(self, K=self.K * scale, height=height, width=width)


@dataclass(frozen=True)
class Gaussians(Movable):
    """A splat: n Gaussians in the unconstrained parameters that are stored and optimised (as in 3DGS).

    Args:
        means: centres in the world.
        log_scales: natural logarithm of the standard deviation along each local axis; two axes mean disks (2DGS).
        quaternions: rotation from local axes to the world, (w, x, y, z), of any non-zero length.
        opacity_logits: opacity before the sigmoid.
        sh: spherical-harmonics colour coefficients, 3DGS order and sign; colour = SH(direction) + 0.5.
        smoothing: standard deviation of Mip-Splatting's 3D low-pass filter, in world units; None for other methods.
    """

    means: Float[Tensor, "n 3"]
    log_scales: Float[Tensor, "n s"]
    quaternions: Float[Tensor, "n 4"]
    opacity_logits: Float[Tensor, " n"]
    sh: Float[Tensor, "n k 3"]
    smoothing: Float[Tensor, " n"] | None = None

    def __len__(self) -> int:
        return self.means.shape[0]

    def __getitem__(self, index: Tensor) -> "Gaussians":
        """The Gaussians that a mask or an index tensor selects."""
        return Gaussians(**{name: None if value is None else value[index] for name, value in self.tensors().items()})  # type: ignore[arg-type]

    def tensors(self) -> dict[str, Tensor | None]:
        """The parameters by name."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}


@dataclass(frozen=True)
class Render(Movable):
    """Output of a rasteriser for one camera.

    Args:
        colour: composited over the background, not clamped.
        depth: expected z (weights normalised by alpha), 0 where alpha is below 1e-3.
        alpha: accumulated opacity in [0, 1].
        median_depth: z at which transmittance falls below one half, 0 where it never does; None if not requested.
        normals: unit normals in camera axes towards the camera (2DGS), 0 where nothing was hit; None for other methods.
    """

    colour: Float[Tensor, "3 h w"]
    depth: Float[Tensor, "1 h w"]
    alpha: Float[Tensor, "1 h w"]
    median_depth: Float[Tensor, "1 h w"] | None = None
    normals: Float[Tensor, "3 h w"] | None = None

    @property
    def surface(self) -> Float[Tensor, "1 h w"]:
        """Surface depth: median z, or expected z where less than half is covered or the median is not available.

        Expected z lies between the surfaces that a pixel mixes; references warped with median depth are aligned better
        (docs/networks.md).
        """
        if self.median_depth is None:
            return self.depth
        return torch.where(self.median_depth > 0, self.median_depth, self.depth)


@dataclass(frozen=True)
class NetworkInput(Movable):
    """Input of an enhancement network for a batch of targets. H = 4 h, W = 4 w.

    References lie on the target's pixel grid: they are warped where the alignment uses geometry, and only resized
    otherwise. A reference that is missing, or does not show the surface at a pixel, has visibility 0 there.

    Args:
        render: splat render of the target view.
        references: photos on the target's grid, zero where not visible.
        visibility: how surely each reference shows the target's surface at the pixel, in [0, 1].
        depth: rendered depth of the target; None if the renderer provides none.
        alpha: rendered opacity of the target; None if the renderer provides none.
        depth_unit: the length that counts as 1 when a network normalises depth, so that all crops and tiles of an
            image use the same unit; None means the median of the given depth.
        reference_renders: the splat's renders of the references' views, warped or resized like the references. Photo
            minus reference render shows the splat's error; reference render minus ``render`` shows how well the two
            are aligned. None if the renderer provides none.
        fine_references: the references on a grid 4 times as fine, for super-resolution; None if not requested.
    """

    render: Float[Tensor, "b 3 h w"]
    references: Float[Tensor, "b r 3 h w"]
    visibility: Float[Tensor, "b r 1 h w"]
    depth: Float[Tensor, "b 1 h w"] | None = None
    alpha: Float[Tensor, "b 1 h w"] | None = None
    depth_unit: Float[Tensor, " b"] | None = None
    reference_renders: Float[Tensor, "b r 3 h w"] | None = None
    fine_references: Float[Tensor, "b r 3 H W"] | None = None

    def map_images(self, change: Callable[[Tensor, int], Tensor]) -> "NetworkInput":
        """Apply the same change to every image, for instance cropping, padding or flipping.

        Args:
            change: function of images (..., height, width) and of their grid's resolution relative to the render's.
        """
        scales = {"fine_references": 4}
        images = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "depth_unit"}
        changed = {n: None if i is None else change(i, scales.get(n, 1)) for n, i in images.items()}
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Batch(Movable):
    """Training or validation samples.

    Args:
        views: input of the network.
        photo: the desired output, at the render's size or, for super-resolution, 4 times as fine.
        names: names of the samples.
        real: the fits' own renders if ``views.render`` was simulated; None if there is no simulator.
    """

    views: NetworkInput
    photo: Float[Tensor, "b 3 _ _"]
    names: tuple[str, ...] = ()
    real: Float[Tensor, "b 3 h w"] | None = None


def identity_camera(height: int, width: int, focal: float, dtype: torch.dtype = torch.float32) -> Camera:
    """A camera at the world's origin that looks along +z, with its principal point at the image's centre."""
    K = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]], dtype=dtype)
    return Camera(K, torch.eye(4, dtype=dtype), height, width)


FARTHEST_DEPTH = 1e12
"""Largest usable depth in scene units; beyond it, squared differences overflow. Blender writes 1e10 as background."""


def usable_depth(depth: Float[Tensor, "*b h w"]) -> Bool[Tensor, "*b h w"]:
    """Mask of depths that are finite, positive and at most `FARTHEST_DEPTH`, which is infinite in half precision."""
    in_range = (depth > 0) & (depth <= FARTHEST_DEPTH)  # False for NaN
    return in_range & torch.isfinite(depth) if depth.dtype == torch.float16 else in_range


def single_precision(values: Float[Tensor, "*axes"]) -> Float[Tensor, "*axes"]:
    """Convert half-precision values to single precision; other types are returned unchanged."""
    return values.to(torch.promote_types(values.dtype, torch.float32))


def numpy_view(tensor: Tensor) -> np.ndarray:
    """A contiguous NumPy view of a CPU tensor for compiled kernels, copied only if it is not contiguous."""
    return tensor.detach().contiguous().numpy()


def quantise_8_bit(image: Float[Tensor, "*b c h w"]) -> Float[Tensor, "*b c h w"]:
    """The image as stored in an 8-bit file: clamped to [0, 1] and rounded to multiples of 1/255."""
    return torch.round(image.clamp(0, 1) * 255) / 255


def fastest_dtype() -> torch.dtype:
    """The data type in which the CPU computes convolutions fastest.

    Emulated bfloat16 is slower than float32, so only CPUs with bfloat16 instructions use it.
    """
    return torch.bfloat16 if torch.cpu._is_avx512_bf16_supported() else torch.float32


def orthonormal_pose(world_to_camera: Float[Tensor, "4 4"], where: object) -> Float[Tensor, "4 4"]:
    """Make the rotation of a pose exactly orthonormal, since files store rounded values.

    Args:
        world_to_camera: the pose.
        where: owner of the pose, for messages.

    Raises:
        InputError: the pose is not finite or too far away for single precision, or its rotation is scaled, skewed or
            mirrored by more than 1%.
    """
    if not bool(torch.isfinite(world_to_camera).all()):
        raise InputError(where, "has a pose with NaN or infinity", "remove the photo or calibrate again")
    largest = float(world_to_camera.abs().max())
    if largest > MAX_POSE_VALUE:
        received = f"has a pose with the value {largest:g}"
        raise InputError(where, received, f"bring the scene near the origin: at most {MAX_POSE_VALUE:g} units away")
    U, scales, Vh = torch.linalg.svd(world_to_camera[:3, :3])
    if float((scales - 1).abs().max()) > 0.01 or float(torch.linalg.det(U @ Vh)) < 0:
        received = f"has a pose whose 3x3 part has scales {[round(s, 4) for s in scales.tolist()]} or is mirrored"
        raise InputError(where, received, "export rigid poses: rotation and translation only")
    pose = torch.eye(4, dtype=world_to_camera.dtype)
    pose[:3, :3] = U @ Vh
    pose[:3, 3] = world_to_camera[:3, 3]
    return pose


def _matrix(name: str, values: Any, *shapes: tuple[int, int]) -> Tensor:
    """Convert values to a matrix in double precision and refuse other shapes than those listed."""
    try:
        matrix = torch.as_tensor(values, dtype=torch.float64, device="cpu")
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(name, f"is no matrix ({error})", "give a numpy array, a tensor or a list of rows") from None
    if tuple(matrix.shape) not in shapes:
        permitted = " or ".join(str(shape) for shape in shapes)
        raise InputError(name, f"has shape {tuple(matrix.shape)}", f"give shape {permitted}")
    return matrix.detach()
