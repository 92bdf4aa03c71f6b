"""Material recipes of `harbour` scenes, for `Palette`."""

from collections.abc import Callable
from functools import partial

from gaussian_enhancer.scene.procedural import harbour_textures as marine
from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.draft import Draft
from gaussian_enhancer.scene.procedural.noise import Colour, random_muted_colour
from gaussian_enhancer.scene.procedural.palette import Recipes
from gaussian_enhancer.scene.procedural.textures import Random, bark, foliage, metal, plaster

Range = tuple[float, float]
Paint = Callable[[Random, Colour], Texture]

BLUE, RED, GREEN, OCHRE = (0.54, 0.64), (0.97, 1.03), (0.32, 0.45), (0.08, 0.14)
ORANGE, YELLOW, STONE = (0.02, 0.06), (0.11, 0.15), (0.07, 0.13)


def _recipe(
    paint: Paint, saturation: Range, value: Range, hues: tuple[Range, ...], size: float, **looks: float
) -> Callable[[Draft], int]:
    """Make a recipe with a random colour of one of several hues; the texture repeats every `size` metres."""

    def recipe(d: Draft) -> int:
        hue = hues[int(d.rng.integers(len(hues)))]
        return d.material(paint(d.rng, random_muted_colour(d.rng, saturation, value, hue)), size, **looks)

    return recipe


def _plain(paint: Paint, colour: Colour, size: float, **looks: float) -> Callable[[Draft], int]:
    """Make a recipe with a fixed colour."""
    return lambda d: d.material(paint(d.rng, colour), size, **looks)


def _hull(rng: Random, colour: Colour) -> Texture:
    line_colour = random_muted_colour(rng, (0.0, 0.2), (0.75, 0.95))
    underwater_colour = random_muted_colour(rng, (0.4, 0.7), (0.25, 0.45), (0.98, 1.04))
    return marine.hull(rng, colour, line_colour, underwater_colour)


MATERIALS: Recipes = {
    "water": _recipe(
        marine.ripples, (0.3, 0.55), (0.1, 0.2), ((0.42, 0.56),), 3.1,
        reflectance=0.05, roughness=0.03, relief=0.035, detail=0.0, dirt=0.15,
    ),
    "hull": _recipe(
        _hull, (0.3, 0.7), (0.2, 0.75), (BLUE, RED, GREEN, OCHRE), 2.0,
        reflectance=0.06, roughness=0.22, relief=0.003, detail=0.2,
    ),
    "deck": _recipe(marine.laid_deck, (0.15, 0.4), (0.5, 0.7), (STONE,), 0.6, relief=0.004, detail=0.2),
    "spar": _recipe(
        marine.laid_deck, (0.4, 0.65), (0.4, 0.6), ((0.06, 0.1),), 0.9, reflectance=0.05, roughness=0.25, relief=0.001
    ),
    "gelcoat": _recipe(
        plaster, (0.0, 0.08), (0.82, 0.93), (OCHRE, BLUE), 1.7,
        reflectance=0.06, roughness=0.15, relief=0.0, detail=0.08, dirt=0.2,
    ),
    "pane": _plain(
        plaster, (0.07, 0.09, 0.1), 3.0, reflectance=0.2, roughness=0.01, relief=0.0, detail=0.0, dirt=0.05
    ),
    "mirror": _plain(
        partial(metal, rust=0.0), (0.9, 0.92, 0.93), 2.0,
        reflectance=0.9, roughness=0.0, relief=0.0, detail=0.0, dirt=0.0,
    ),
    "steel": _plain(partial(metal, rust=0.05), (0.66, 0.68, 0.7), 0.5, reflectance=0.5, roughness=0.25, relief=0.001),
    "alloy": _plain(partial(metal, rust=0.0), (0.74, 0.75, 0.76), 0.7, reflectance=0.35, roughness=0.4, relief=0.001),
    "tar": _plain(bark, (0.12, 0.12, 0.13), 0.4, reflectance=0.05, roughness=0.4, relief=0.004),
    "tyre": _plain(bark, (0.09, 0.09, 0.095), 0.15, reflectance=0.03, roughness=0.6, relief=0.003),
    "pile": _recipe(bark, (0.1, 0.3), (0.25, 0.4), ((0.1, 0.2),), 0.7, relief=0.01),
    "trunk": _recipe(bark, (0.3, 0.5), (0.35, 0.5), ((0.03, 0.07),), 0.5, relief=0.02),
    "paintwork": _recipe(
        metal, (0.5, 0.8), (0.4, 0.75), (OCHRE, BLUE, RED), 0.9, reflectance=0.05, roughness=0.3, relief=0.003
    ),
    "net": _recipe(
        marine.netting, (0.3, 0.7), (0.3, 0.6), (GREEN, ORANGE, BLUE), 0.55,
        relief=0.001, translucency=0.3, reflectance=0.02,
    ),
    "twine": _recipe(marine.rope, (0.4, 0.7), (0.3, 0.5), ((0.4, 0.5),), 0.2, relief=0.004),
    "rope": _recipe(
        marine.rope, (0.15, 0.4), (0.6, 0.8), (YELLOW,), 0.08, relief=0.002, reflectance=0.02, roughness=0.9
    ),
    "sail": _recipe(
        marine.sailcloth, (0.02, 0.5), (0.6, 0.92), (YELLOW, RED), 2.2,
        relief=0.01, translucency=0.4, reflectance=0.02, roughness=0.8,
    ),
    "registration": lambda d: d.material(marine.registration(d.rng), 1.0, relief=0.0, detail=0.1, roughness=0.3),
    "crate": _recipe(
        marine.corrugated, (0.4, 0.7), (0.35, 0.7), (BLUE, RED, YELLOW, OCHRE), 0.5, relief=0.003, reflectance=0.04
    ),
    "corrugated": _recipe(
        marine.corrugated, (0.08, 0.5), (0.4, 0.75), (OCHRE, BLUE, RED, GREEN), 1.8,
        relief=0.02, reflectance=0.06, roughness=0.45,
    ),
    "ashlar": _recipe(marine.ashlar, (0.04, 0.2), (0.45, 0.65), (STONE,), 2.3, relief=0.03),
    "paving": _recipe(marine.ashlar, (0.02, 0.15), (0.45, 0.6), (STONE, BLUE), 3.0, relief=0.015, detail=0.4),
    "buoy": _recipe(
        plaster, (0.65, 0.85), (0.6, 0.85), (ORANGE, YELLOW, RED), 0.8,
        reflectance=0.05, roughness=0.2, relief=0.002, detail=0.15,
    ),
    "band": _recipe(plaster, (0.6, 0.8), (0.45, 0.65), (RED,), 2.0, relief=0.002),
    "glow": _plain(plaster, (0.95, 0.82, 0.55), 0.5, emission=2.4, relief=0.0, detail=0.0),
    "reed": _recipe(
        marine.laid_deck, (0.3, 0.55), (0.4, 0.65), ((0.13, 0.22),), 0.4,
        relief=0.0, translucency=0.4, reflectance=0.03,
    ),
    "bulrush": _plain(bark, (0.32, 0.22, 0.14), 0.2, relief=0.002),
    "needles": _recipe(
        marine.needles, (0.3, 0.55), (0.25, 0.42), ((0.26, 0.42),), 1.0,
        relief=0.0, translucency=0.25, reflectance=0.03,
    ),
    "wood": _recipe(foliage, (0.25, 0.5), (0.2, 0.35), ((0.25, 0.45),), 4.0, relief=0.05),
}  # fmt: skip
