"""Techniques by name, as values: what each makes, from which dataset's scene, and whether it draws layers of cells.

full, visible, local      geometry only                                     (viewer.techniques.geometry)
single-mesh               the same city and parameters, one layer a view; built where it is not there yet
multi-mesh                the dataset that is compared                      (viewer.techniques.layered)
multi-mesh-dynamic        the same, layers captured again while time allows (viewer.techniques.dynamic)
ray-cast                  near geometry, and rays for the rest              (viewer.techniques.ray_cast)
image-cache               images of boxes that hold everything              (viewer.techniques.image_cache)
placed-images             layered depth images, placed for a budget         (viewer.techniques.placed_images)

A technique of one's own needs no entry here: ``package.module:function`` names a function that is called with the scene of the
dataset that is compared and returns a technique (:mod:`mmi.foundation.plug_ins`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from mmi.foundation.camera import View
from mmi.foundation.errors import ParameterError
from mmi.foundation.plug_ins import PlugIn, names_plug_in, own_mistakes, plug_in
from viewer.caching.rules import CacheRules
from viewer.casting.rules import CastRules
from viewer.placed.rules import PlacedRules
from viewer.plan import Budget, Plan, Technique
from viewer.scene.scene import WalkScene
from viewer.techniques.dynamic import DynamicImpostors
from viewer.techniques.geometry import CellGeometry, FullGeometry
from viewer.techniques.image_cache import ImageCache, tree_of
from viewer.techniques.layered import LayeredImpostors
from viewer.techniques.placed_images import PlacedImages
from viewer.techniques.ray_cast import RayCasting
from viewer.techniques.virtual_frames import FrameRules
from viewer.techniques.with_movers import WithMovers

__all__ = [
    "MAIN",
    "REFERENCE",
    "TECHNIQUES",
    "TechniqueEntry",
    "TechniqueRules",
    "find_technique",
    "make_technique",
    "refuse_without_dataset",
]

MAIN = "multi-mesh"
"""The scene of the dataset that is compared, and the technique that draws it."""
REFERENCE = "full"
"""What the others are compared with."""


@dataclass(frozen=True, slots=True)
class TechniqueRules:
    """What a user says of techniques: ``fade``, seconds of a cross-fade at changes of cells, how ``rays`` are cast, and how
    ``images`` of boxes are kept, and where ``placed`` images are.
    """

    fade: float = 0.0
    rays: CastRules = field(default_factory=CastRules)
    images: CacheRules = field(default_factory=CacheRules)
    placed: PlacedRules = field(default_factory=PlacedRules)


_Make = Callable[[WalkScene, TechniqueRules], Technique]


@dataclass(frozen=True, slots=True)
class TechniqueEntry:
    """A technique by its ``name``.

    ``make`` takes the scene called ``scene`` and what users say of techniques, and returns a fresh technique, which knows of no
    viewer yet. ``layered``: it draws layers of cells, which are loaded, and pop where cells
    change. ``cells``: it needs a dataset, since it draws what that says of cells; others draw a city as it was read as well.
    ``prepare`` makes what it needs once of a scene, which may take a minute in a large city, None: nothing; ``make`` does so as
    well. ``origin`` is the plug-in that a technique comes from, None for the package's own.
    """

    name: str
    make: _Make
    scene: str = MAIN
    layered: bool = False
    cells: bool = False
    prepare: Callable[[WalkScene, TechniqueRules], object] | None = None
    origin: PlugIn | None = None


TECHNIQUES: Mapping[str, TechniqueEntry] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            TechniqueEntry("full", lambda scene, _: FullGeometry(scene)),
            TechniqueEntry("visible", lambda scene, _: CellGeometry(scene, "visible"), cells=True),
            TechniqueEntry("local", lambda scene, _: CellGeometry(scene, "local"), cells=True),
            TechniqueEntry(
                "single-mesh",
                lambda scene, rules: LayeredImpostors(scene, fade=rules.fade),
                "single-mesh",
                layered=True,
                cells=True,
            ),
            TechniqueEntry(
                "multi-mesh", lambda scene, rules: LayeredImpostors(scene, fade=rules.fade), layered=True, cells=True
            ),
            TechniqueEntry(
                "multi-mesh-dynamic",
                lambda scene, rules: DynamicImpostors(scene, fade=rules.fade),
                layered=True,
                cells=True,
            ),
            TechniqueEntry(
                "ray-cast",
                lambda scene, rules: RayCasting(scene, rules.rays),
                prepare=lambda scene, rules: RayCasting(scene, rules.rays),
            ),
            TechniqueEntry(
                "image-cache",
                lambda scene, rules: ImageCache(scene, rules.images),
                prepare=lambda scene, rules: tree_of(scene, rules.images),
            ),
            TechniqueEntry(
                "placed-images",
                lambda scene, rules: PlacedImages(scene, rules.placed),
                prepare=lambda scene, rules: PlacedImages(scene, rules.placed),
            ),
        )
    }
)
"""The package's own techniques, by name."""


def find_technique(of: str | Callable[..., Any] | PlugIn | TechniqueEntry) -> TechniqueEntry:
    """The entry of a technique: one of :data:`TECHNIQUES` by its name, or one of somebody's own.

    The latter is a function of the scene, itself or as ``package.module:function``, or a plug-in, which has a name and a
    version of its own. It counts as layered, since it may draw whatever it likes. Raises ParameterError for an unknown name, a
    plug-in that has the name of one of the package's techniques, and what :func:`mmi.foundation.plug_ins.plug_in` refuses.
    """
    if isinstance(of, TechniqueEntry):
        return of
    if isinstance(of, str) and not names_plug_in(of):
        if of not in TECHNIQUES:
            raise ParameterError(
                f"technique {of!r}: one of {', '.join(TECHNIQUES)} expected, or package.module:function for one of your own"
            )
        return TECHNIQUES[of]
    origin = plug_in(of)
    if origin.name in TECHNIQUES:
        raise ParameterError(
            f"technique {origin.target}: a name that no other technique has expected, found {origin.name!r}"
        )

    def make(scene: WalkScene, _: TechniqueRules) -> Technique:
        with own_mistakes(f"technique {origin.target}"):
            made = origin.function(scene)
        if not callable(getattr(made, "plan", None)):
            raise ParameterError(
                f"technique {origin.target}: a technique, which has a method plan, expected from it, "
                f"found a value of type {type(made).__name__}"
            )
        return _OwnTechnique(origin, made)

    return TechniqueEntry(origin.name, make, layered=True, origin=origin)


def refuse_without_dataset(entries: Iterable[TechniqueEntry], source: str) -> None:
    """Raises ParameterError for a technique that needs a dataset, where the city ``source`` is to be drawn as it was read."""
    for entry in entries:
        if entry.cells:
            raise ParameterError(
                f"techniques: for the city {source}, those that need no dataset expected, found {entry.name}, which draws "
                "cells of one; build-impostors makes one"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _OwnTechnique:
    """A technique from outside the package, whose mistakes are told as such."""

    origin: PlugIn
    made: Technique

    @property
    def name(self) -> str:
        """What reports call it."""
        return self.origin.name

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:
        """What the technique plans. Raises ParameterError where it fails, or plans something else."""
        with own_mistakes(f"technique {self.origin.target}"):
            found = self.made.plan(view, now=now, budget=budget)
        if not isinstance(found, Plan):
            raise ParameterError(
                f"technique {self.origin.target}: a Plan expected of it, found a value of type {type(found).__name__}"
            )
        return found


def make_technique(
    of: str | Callable[..., Any] | PlugIn | TechniqueEntry,
    scenes: Mapping[str, WalkScene],
    *,
    rules: TechniqueRules | None = None,
    frames: FrameRules | None = None,
    at: float | None = None,
    owner: str | None = None,
) -> Technique:
    """A fresh technique, which knows of no viewer yet. ``scenes``: ``multi-mesh``, and ``single-mesh`` where that is asked for.

    ``rules`` are what a user says of techniques. It also draws what moves in its scene, as it is ``at`` a time (seconds; None:
    as time goes by): layered techniques by the rules of ``frames``, all others as geometry. All but the reference leave out
    what buildings hide of it. Where several viewers are drawn by one renderer, the images that are captured for this one are
    those of ``owner``. Raises ParameterError for what :func:`find_technique` refuses.
    """
    entry = find_technique(of)
    scene = scenes[entry.scene]
    made = entry.make(scene, rules or TechniqueRules())
    if owner is not None and isinstance(made, DynamicImpostors | ImageCache):
        made.owner = owner
    if not scene.movers.ids:
        return made
    of_images = frames if entry.layered else None
    skyline = None if entry.name == REFERENCE else scene.skyline
    return WithMovers(made, scene.movers, scene.camera, rules=of_images, skyline=skyline, at=at)
