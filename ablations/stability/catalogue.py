"""All cases."""

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
    """The cases, all or some.

    Args:
        families: only these.
        names: only these cases.

    Raises:
        InputError: there is no such family or case.
    """
    refuse_unknown("families", families, FAMILIES)
    found = [case for family, cases in FAMILIES.items() if families is None or family in families for case in cases()]
    refuse_unknown("cases", names, sorted(case.name for case in found))
    return [case for case in found if names is None or case.name in names]
