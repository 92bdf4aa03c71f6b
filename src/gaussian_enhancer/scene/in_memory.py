"""Views whose pixels stay in memory, so that measurements exclude reading."""

import functools
from dataclasses import replace

from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView


def read_once(view: RenderedView) -> RenderedView:
    """The view, each of its files read at most once, when it is first asked for."""
    reads = (view.read, view.read_depth, view.read_alpha, view.read_photo, view.read_fine_photo)
    read, depth, alpha, photo, fine = (None if one is None else functools.cache(one) for one in reads)
    return replace(view, read=read, read_depth=depth, read_alpha=alpha, read_photo=photo, read_fine_photo=fine)


def single_target_sets(rendered: RenderedSet, count: int) -> tuple[RenderedSet, ...]:
    """Sets of one target each, evenly spread over those of a set, with all its references; all held.

    Args:
        rendered: the set.
        count: of targets at most.
    """
    targets, references = rendered.targets, tuple(map(read_once, rendered.references))
    count = min(count, len(targets))
    chosen = (targets[index * len(targets) // count] for index in range(count))
    return tuple(replace(rendered, targets=(read_once(target),), references=references) for target in chosen)
