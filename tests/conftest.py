"""Set before any test module imports torch: the package's own threading defaults."""

import gaussian_enhancer  # noqa: F401
