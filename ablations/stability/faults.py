"""Faults found while the matrix was built, by its cells or by reading what a case reaches, each with that case."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """A fault.

    Args:
        case: that holds it.
        fault: what happened.
        remedy: what happens now.
    """

    case: str
    fault: str
    remedy: str


FAULTS: tuple[Fault, ...] = (
    Fault(
        "ordinary_3dgs",
        "splats in bfloat16 or float16, and splats with a camera of another type, ended in an error about matrices",
        "they are drawn in float32, and the image is float32",
    ),
    Fault(
        "focal_1e5_3dgs",
        "gradients of a splat in float16 became infinite where they are larger than float16 holds",
        "they are refused by an error that names the part",
    ),
    Fault(
        "constant_simulated",
        "photos in half precision ended in an error of the artefacts, and autocast rounded what they draw",
        "artefacts are computed in float32 outside of autocast; a photo that is not finite is refused",
    ),
    Fault(
        "not_finite_3dgs",
        "the float64 twin made NaN of Gaussians that the compiled kernels leave out",
        "the twin leaves them out as well",
    ),
    Fault(
        "harmonics_3dgs",
        "spherical harmonics that are not finite gave colours and gradients that are not finite, by all three methods",
        "every value of a Gaussian is judged as its centre and scales are; one that cannot be drawn is left out",
    ),
    Fault(
        "log_scale_90_2dgs",
        "a disk with a log scale of 90 gave NaN depth",
        "scales beyond exp(40) are left out",
    ),
    Fault(
        "log_scale_-1e30_3dgs",
        "an ellipsoid with a log scale of -10^30 gave NaN gradients",
        "scales below exp(-100) are left out",
    ),
    Fault(
        "noise_lr_tiny",
        "networks in bfloat16, float16 or float64 ended in an error: parts of them were always float32",
        "normalised depth and trust are computed in float32 at least and handed on in the network's own type",
    ),
    Fault(
        "zero_warp",
        "views in half precision could not be warped, autocast reached into the geometry, and images that ask for a "
        "gradient ended in an error of the compiled search",
        "views are warped in float32 outside of autocast; no gradient passes through the search of depth",
    ),
    Fault(
        "half_size_unwarped",
        "references in half precision could not be resized",
        "they are resized in float32",
    ),
    Fault(
        "tiny_warp",
        "what lies before a camera was judged by 1e-6 scene units: references of a tiny scene were not seen, and the "
        "check for occlusion passed everything",
        "it is judged by 1e-6 of the depth; near planes follow the cameras where a scene's unit is extraordinary",
    ),
    Fault(
        "nan_in_render",
        "a single NaN in a view spread over the enhanced image without a word",
        "the view is refused by an error that names the part",
    ),
    Fault(
        "some_1e38_warp",
        "depth of 1e38, which is finite, warped references to nowhere; where only some was so deep, the search for "
        "depth ended in an error",
        "depth beyond 10^12 scene units counts as unknown, as it is refused in files",
    ),
    Fault(
        "1e30_in_render",
        "a patch of 1e30 in a render, which is finite, gave an image of NaN",
        "colours beyond 1000 are refused by an error that names the part",
    ),
    Fault(
        "steep_64",
        "schedules that stand still at an end were divided by zero; in half precision the walk's roundings added up, "
        "and the time's short waves were lost",
        "z stays where no signal has come, and is the clean code where no noise is left; z and time are float32",
    ),
    Fault(
        "steep_1000",
        "where no noise was left long before the end, the denoiser went on with its own clean code, which grew beyond "
        "what single precision holds",
        "the walk ends where no noise is left; walks of more than 64 steps stay outside autocast, whose roundings a "
        "stiff schedule magnified to the size of the codes",
    ),
    Fault(
        "nan_in_a_sample",
        "one NaN in a batch made all weights NaN; NaN in a photo became black in the prepared samples",
        "such samples are named, counted and left without weight; too large a share of them fails the training",
    ),
)
