"""What keeps an enhancer from doing harm, and what that costs: gains on validation runs by the limits it is held to.

    python -m ablations.scripts.guards GUARD WEIGHTS [WEIGHTS ...] --runs RUN [RUN ...]
        [--every N] [--lpips FOLDER] [--json FILE]

GUARD is ``photo_consistency`` (how far a reference may differ from the render, `Reprojected.photo_consistency`),
``colour_clamping`` (the window whose colours a pixel stays within,
`SetEnhancer`) or ``strength`` (the share of the change that is applied). Runs
must be validation runs (docs/data.md): limits that were chosen on test scenes would be worth nothing.
"""

import argparse
from dataclasses import replace

from ablations.scripts.candidates import add_options, loaded, show
from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.weights import Pretrained

LIMITS: dict[str, tuple[float | None, ...]] = {
    "photo_consistency": (None, 0.3, 0.2, 0.15, 0.1),
    "colour_clamping": (0, 1, 3, 5, 9),
    "strength": (0.5, 0.8, 1.0),
}
"""What is compared of each guard; None and 0 switch photo-consistency and colour clamping off."""


def guarded(pretrained: Pretrained, guard: str, limit: int | float | None) -> SetEnhancer:
    """A network held to a limit; all else is as the job enhance has it.

    Raises:
        InputError: references are not warped, so that they are not checked.
    """
    reference_config = pretrained.reference_config
    if guard == "colour_clamping":
        return SetEnhancer(
            pretrained.network, reference_config, strength=pretrained.strength, colour_clamping=int(limit or 0)
        )
    if guard == "strength":
        return SetEnhancer(pretrained.network, reference_config, strength=1.0 if limit is None else limit)
    if not isinstance(reference_config.warp, Reprojected):
        raise InputError("weights", "do not warp their references", "give weights with alignment=reprojected")
    checked = replace(reference_config, warp=replace(reference_config.warp, photo_consistency=limit))
    return SetEnhancer(pretrained.network, checked, strength=pretrained.strength)


def main() -> None:
    """Read the command line, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("guard", choices=sorted(LIMITS))
    add_options(parser)
    options = parser.parse_args()
    made = {
        f"{name}, {options.guard} {limit}": guarded(found, options.guard, limit)
        for name, found in loaded(options.weights).items()
        for limit in LIMITS[options.guard]
    }
    show(made, options, "limit")


if __name__ == "__main__":
    main()
