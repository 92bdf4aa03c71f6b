"""Constants that all rasterisation kernels share: the thresholds of 3DGS, and the side of a tile."""

ALPHA_MIN = 1.0 / 255.0
"""A Gaussian is skipped at pixels where its alpha is below this."""
ALPHA_MAX = 0.99
"""Upper limit of alpha, so that transmittance never reaches zero."""
TRANSMITTANCE_MIN = 1e-4 * (1 - 1e-4)
"""A pixel stops before the Gaussian that would bring its transmittance below this: 1e-4 with a margin for rounding. Two
Gaussians at the upper limit of alpha leave (1 - 0.99)^2 = 1e-4 exactly, which must not stop a pixel only in float32."""
MIN_DEPTH_ALPHA = 1e-3
"""A pixel with less accumulated alpha than this has no depth: its depth is 0."""
TILE = 16
"""Side of a tile in pixels: the number of float32 values in an AVX-512 register."""
