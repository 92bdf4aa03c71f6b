"""All cases."""

from collections.abc import Sequence

from ablations.stability import depth, images, offsets, references, sampler, splats, training
from ablations.stability.case import Case
from gaussian_enhancer.errors import InputError

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
    for family in families or ():
        if family not in FAMILIES:
            raise InputError("families", f"names {family!r}", f"choose from {', '.join(FAMILIES)}")
    found = [case for family, cases in FAMILIES.items() if families is None or family in families for case in cases()]
    known = {case.name for case in found}
    for name in names or ():
        if name not in known:
            raise InputError("cases", f"names {name!r}", f"choose from {', '.join(sorted(known))}")
    return [case for case in found if names is None or case.name in names]
