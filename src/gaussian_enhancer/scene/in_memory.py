"""Views whose pixels are cached in memory, so that timings exclude reading from disk."""

import functools
from dataclasses import replace

from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.scene.splits import evenly_spaced


def read_once(view: RenderedView) -> RenderedView:
    """The view with cached readers: each file is read at most once, on first use."""
    readers = (view.read, view.read_depth, view.read_alpha, view.read_photo, view.read_fine_photo)
    read, depth, alpha, photo, fine_photo = (None if reader is None else functools.cache(reader) for reader in readers)
    return replace(view, read=read, read_depth=depth, read_alpha=alpha, read_photo=photo, read_fine_photo=fine_photo)


def single_target_sets(rendered: RenderedSet, count: int) -> tuple[RenderedSet, ...]:
    """Split a set into sets of one target each, with all references and cached readers.

    The targets are evenly spaced over those of the set.

    Args:
        rendered: the set.
        count: maximum number of targets.
    """
    references = tuple(map(read_once, rendered.references))
    targets = map(read_once, evenly_spaced(rendered.targets, count))
    return tuple(replace(rendered, targets=(target,), references=references) for target in targets)
