"""The catalogue of all cases, by family."""

from collections.abc import Sequence

from ablations.stability import depth, images, offsets, references, sampler, splats, training
from ablations.stability.case import Case
from gaussian_enhancer.errors import refuse_unknown

FAMILIES = {
    "splats": splats.cases,
    "images": images.cases,
    "depth": depth.cases,
    "references": references.cases,
    "offsets": offsets.cases,
    "sampler": sampler.cases,
    "training": training.cases,
}


def catalogue(families: Sequence[str] | None = None, names: Sequence[str] | None = None) -> list[Case]:
    """All cases, or a selection.

    Args:
        families: only these families; None for all.
        names: only these cases; None for all.

    Raises:
        InputError: there is no such family or case.
    """
    refuse_unknown("families", families, FAMILIES)
    selected = [
        case for family, cases in FAMILIES.items() if families is None or family in families for case in cases()
    ]
    refuse_unknown("cases", names, sorted(case.name for case in selected))
    return [case for case in selected if names is None or case.name in names]
