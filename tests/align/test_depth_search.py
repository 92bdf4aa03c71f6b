"""What a target's depth is decides how far it is searched."""

import json

import pytest
from jaxtyping import TypeCheckError

from gaussian_enhancer.align.alignment import Reprojected
from gaussian_enhancer.align.depth_search import LARGE_IMAGE, SEARCHES, Search
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.weights import build_reference_config, reference_config_of


@pytest.mark.parametrize("kind", SEARCHES)
def test_weights_name_the_kind(kind):
    reference_config = ReferenceConfig(Reprojected(depth=kind), 3, 5)
    assert build_reference_config(json.loads(json.dumps(reference_config_of(reference_config)))) == reference_config


@pytest.mark.parametrize("kind", ["true", 3, None])
def test_an_unknown_kind_is_refused(kind):
    with pytest.raises((ValueError, TypeCheckError), match="depth"):  # types are checked in tests alone
        Reprojected(depth=kind)


def test_large_images_have_their_own_stride():
    search = Search(0.03, 7, stride=2, large_stride=3)
    assert search.for_pixels(LARGE_IMAGE) is search
    assert search.for_pixels(LARGE_IMAGE + 1) == Search(0.03, 7, stride=3, large_stride=3)
    assert Search(0.03, 7).for_pixels(LARGE_IMAGE + 1) == Search(0.03, 7)
