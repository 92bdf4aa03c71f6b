"""From renders and references to enhanced images: enhancer, tiles, plan, weights."""
