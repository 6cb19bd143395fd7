"""What casting needs of a city, made once of a scene and shared by all of its viewers: who is near, rays, the horizon."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from mmi.rays.casters import make_caster
from mmi.rays.height_field import HeightField, height_field
from mmi.rays.hits import Caster
from viewer.casting.near_set import Neighbourhoods
from viewer.casting.rules import CastRules
from viewer.casting.surfaces import Surfaces, surfaces_of
from viewer.scene.scene import WalkScene

__all__ = ["FarField", "far_field_of"]


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """``neighbourhoods`` say who is near; ``caster`` finds what a ray hits; ``heights`` give the horizon; ``surfaces`` are the
    city's; ``threads`` are ``workers`` that kernels may run on at once.
    """

    neighbourhoods: Neighbourhoods
    caster: Caster
    heights: HeightField
    surfaces: Surfaces
    threads: ThreadPoolExecutor
    workers: int


def far_field_of(scene: WalkScene, rules: CastRules) -> FarField:
    """The far field of a scene. Takes a second for each million triangles when it is first asked for."""
    shop, mesh = scene.workshop, scene.mesh
    workers = rules.workers
    return FarField(
        neighbourhoods=shop.once(
            ("neighbourhoods", rules.near_field), lambda: Neighbourhoods(scene.boxes, reach=rules.near_field)
        ),
        caster=shop.once(
            ("caster", rules.caster, workers), lambda: make_caster(mesh, kind=rules.caster, workers=workers)
        ),
        heights=shop.once("height field", lambda: height_field(mesh)),
        surfaces=shop.once("surfaces", lambda: surfaces_of(mesh)),
        threads=shop.once(("threads", workers), lambda: ThreadPoolExecutor(workers, "cast")),
        workers=workers,
    )
