"""Named materials of a world, with random colours and patterns.

`Palette` creates a material at its first use, so that a world contains only materials that it uses.
"""

from collections.abc import Callable, Mapping

from gaussian_enhancer.scene.procedural import printed_textures as printed
from gaussian_enhancer.scene.procedural import textures
from gaussian_enhancer.scene.procedural.atlas import Texture
from gaussian_enhancer.scene.procedural.draft import Draft
from gaussian_enhancer.scene.procedural.mesh import SurfacePart
from gaussian_enhancer.scene.procedural.noise import random_earth_colour, random_muted_colour, random_plant_colour

Recipes = Mapping[str, Callable[[Draft], int]]


class Palette:
    """Materials of one draft by name; the same name gives the same material.

    Args:
        draft: the draft to which materials are added.
        recipes: functions that create each kind of material; None takes the recipes of this file.
    """

    def __init__(self, draft: Draft, recipes: Recipes | None = None) -> None:
        self.draft = draft
        self.recipes = _RECIPES if recipes is None else recipes
        self._indices: dict[str, int] = {}

    def __call__(self, name: str) -> int:
        """Return the index of the material of a name, such as "wood" or "wood 2" (another wood)."""
        if name not in self._indices:
            self._indices[name] = self.recipes[name.split(" ")[0]](self.draft)
        return self._indices[name]

    def add(self, part: SurfacePart, material: str, *, casts: bool = True) -> None:
        """Add a placed part to the draft, with the material of a name."""
        self.draft.add(part, self(material), casts=casts)


def _wood(d: Draft) -> int:
    colour = random_muted_colour(d.rng, (0.3, 0.6), (0.3, 0.7), (0.05, 0.11))
    count = int(d.rng.integers(3, 9))
    return d.material(
        textures.planks(d.rng, colour, count),
        d.rng.uniform(0.7, 1.2),
        detail=0.2,
        dirt=0.3,
        reflectance=0.045,
        roughness=0.45,
    )


def _brick(d: Draft) -> int:
    colour = d.pick(
        random_muted_colour(d.rng, (0.35, 0.6), (0.4, 0.65), (0.0, 0.06)), random_earth_colour(d.rng, (0.5, 0.75))
    )
    texture = textures.brick(d.rng, colour, random_earth_colour(d.rng, (0.5, 0.75)), int(d.rng.choice([10, 12, 14])))
    return d.material(texture, d.rng.uniform(0.9, 1.3), relief=0.012)


def _plaster(d: Draft) -> int:
    return d.material(
        textures.plaster(d.rng, random_muted_colour(d.rng, (0.05, 0.35), (0.5, 0.85))),
        d.rng.uniform(1.5, 2.5),
        relief=0.02,
        detail=0.15,
        dirt=0.25,
    )


def _concrete(d: Draft) -> int:
    return d.material(
        textures.concrete(d.rng, random_muted_colour(d.rng, (0.02, 0.12), (0.45, 0.7))), d.rng.uniform(1.2, 2.2)
    )


def _asphalt(d: Draft) -> int:
    return d.material(
        textures.asphalt(d.rng, random_muted_colour(d.rng, (0.0, 0.1), (0.25, 0.42))),
        1.6,
        reflectance=0.04,
        roughness=0.6,
    )


def _cobble(d: Draft) -> int:
    return d.material(
        textures.cobble(d.rng, random_earth_colour(d.rng, (0.4, 0.65))),
        d.rng.uniform(1.0, 1.6),
        relief=0.03,
        roughness=0.5,
    )


def _gravel(d: Draft) -> int:
    return d.material(textures.gravel(d.rng, random_earth_colour(d.rng)), d.rng.uniform(0.8, 1.4), relief=0.02)


def _turf(d: Draft) -> int:
    return d.material(
        textures.turf(d.rng, random_plant_colour(d.rng), random_earth_colour(d.rng, (0.4, 0.6))),
        d.rng.uniform(0.9, 1.6),
        relief=0.03,
    )


def _tiles(d: Draft) -> int:
    light = random_muted_colour(d.rng, (0.02, 0.2), (0.6, 0.85))
    dark = random_muted_colour(d.rng, (0.1, 0.45), (0.25, 0.6))
    pattern = d.rng.choice(["checks", "plain", "ornament"])
    texture = textures.tiles(d.rng, light, dark, int(d.rng.integers(4, 8)), pattern)
    return d.material(texture, d.rng.uniform(1.0, 2.0), reflectance=0.05, roughness=0.25, relief=0.006)


def _cloth(d: Draft) -> int:
    pattern = d.rng.choice(["plaid", "stripes", "dots", "plain"])
    texture = textures.cloth(
        d.rng,
        random_muted_colour(d.rng),
        random_muted_colour(d.rng, value=(0.4, 0.8)),
        pattern,
        int(d.rng.integers(3, 8)),
    )
    return d.material(texture, d.rng.uniform(0.4, 0.8), reflectance=0.02, roughness=0.9, relief=0.004)


def _marble(d: Draft) -> int:
    return d.material(
        textures.marble(d.rng, random_muted_colour(d.rng, (0.02, 0.25), (0.4, 0.9))),
        d.rng.uniform(0.5, 1.1),
        reflectance=0.05,
        roughness=0.15,
        relief=0.0,
    )


def _glaze(d: Draft) -> int:
    dark = random_muted_colour(d.rng, (0.2, 0.6), (0.2, 0.75))
    light = random_muted_colour(d.rng, (0.1, 0.4), (0.5, 0.85))
    texture = textures.tiles(d.rng, dark, light, 4, d.rng.choice(["ornament", "checks"]))
    return d.material(texture, d.rng.uniform(0.25, 0.5), reflectance=0.06, roughness=0.12, relief=0.001, detail=0.15)


def _paint(d: Draft) -> int:
    texture = textures.metal(d.rng, random_muted_colour(d.rng, (0.1, 0.6), (0.2, 0.75)), float(d.rng.uniform(0.0, 0.3)))
    return d.material(texture, 0.9, reflectance=0.06, roughness=0.2, relief=0.002, detail=0.15)


def _chrome(d: Draft) -> int:
    texture = textures.metal(
        d.rng, random_muted_colour(d.rng, (0.0, 0.15), (0.7, 0.88)), float(d.rng.uniform(0.0, 0.25))
    )
    return d.material(
        texture, 0.7, reflectance=0.6, roughness=float(d.rng.uniform(0.12, 0.4)), relief=0.002, detail=0.1
    )


def _iron(d: Draft) -> int:
    texture = textures.metal(
        d.rng, random_muted_colour(d.rng, (0.0, 0.2), (0.12, 0.35)), float(d.rng.uniform(0.1, 0.5))
    )
    return d.material(texture, 0.5, reflectance=0.08, roughness=0.4, relief=0.004)


def _rubber(d: Draft) -> int:
    return d.material(textures.asphalt(d.rng, (0.16, 0.16, 0.165)), 0.2, reflectance=0.04, roughness=0.5, dirt=0.8)


def _glass(d: Draft) -> int:
    return d.material(
        textures.plaster(d.rng, (0.13, 0.15, 0.16)), 2.5, reflectance=0.12, roughness=0.02, relief=0.0, detail=0.1
    )


def _bark(d: Draft) -> int:
    return d.material(textures.bark(d.rng, random_earth_colour(d.rng, (0.3, 0.55))), 0.6, relief=0.02)


def _foliage(d: Draft) -> int:
    return d.material(textures.foliage(d.rng, random_plant_colour(d.rng)), 3.0, relief=0.05)


def _leaves(d: Draft, size: float = 0.5) -> int:
    colour = d.pick(
        random_plant_colour(d.rng),
        random_plant_colour(d.rng),
        random_muted_colour(d.rng, (0.4, 0.65), (0.35, 0.6), (0.05, 0.14)),
    )
    texture = textures.leaves(d.rng, colour, int(d.rng.integers(34, 60)), d.rng.uniform(0.2, 0.5))
    return d.material(texture, size, reflectance=0.04, roughness=0.45, relief=0.002, translucency=0.35, detail=0.2)


def _blades(d: Draft) -> int:
    texture = textures.turf(d.rng, random_plant_colour(d.rng, (0.4, 0.65)), random_earth_colour(d.rng, (0.5, 0.7)))
    return d.material(texture, 1.5, relief=0.0, translucency=0.35, reflectance=0.03)


def _print(paint: Callable[[textures.Random], Texture]) -> Callable[[Draft], int]:
    """Make a recipe of printed paper."""
    return lambda d: d.material(paint(d.rng), 1.0, reflectance=0.03, roughness=0.4, relief=0.0, detail=0.08, dirt=0.2)


def _lamp(d: Draft) -> int:
    texture = textures.cloth(d.rng, (0.85, 0.8, 0.68), (0.8, 0.7, 0.55), "plain")
    return d.material(texture, 0.3, reflectance=0.02, roughness=0.9, emission=1.6, translucency=0.5)


_RECIPES: Recipes = {
    "wood": _wood, "brick": _brick, "plaster": _plaster, "concrete": _concrete, "asphalt": _asphalt,
    "cobble": _cobble, "gravel": _gravel, "turf": _turf, "tiles": _tiles, "cloth": _cloth, "marble": _marble,
    "glaze": _glaze, "paint": _paint, "chrome": _chrome, "iron": _iron, "rubber": _rubber, "glass": _glass,
    "bark": _bark, "foliage": _foliage, "blades": _blades, "lamp": _lamp,
    "leaves": _leaves, "sprig": lambda d: _leaves(d, 0.16),
    "page": _print(printed.page), "poster": _print(printed.poster), "sign": _print(printed.sign),
    "spines": _print(printed.spines),
}  # fmt: skip
