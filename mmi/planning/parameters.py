"""What a build is told: every number and choice that decides the bytes of a dataset, checked once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from types import MappingProxyType
from typing import Any, SupportsFloat

from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.foundation.plug_ins import PlugIn
from mmi.planning.choices import LAYERINGS, NEAR_STAGES, WEIGHTS, Choice, choose
from mmi.planning.frame_costs import FrameCosts

__all__ = ["GEOMETRIES", "PICTURES", "VISIBILITIES", "BuildParameters"]

VISIBILITIES = ("horizon", "item-buffer")
PICTURES = ("all", "none")
"""Which pictures of layers a dataset stores."""
GEOMETRIES = ("near", "cheaper")
"""What is drawn as geometry: near objects, or also what costs less than its layers do."""
_LEFT_OUT = MappingProxyType({"near_stage": None, "pictures": "all"})
"""Parameters that are not written where they have these values, so that datasets keep the bytes that they had without them."""
_OwnOr = str | Callable[..., Any] | PlugIn
_MOST_PIXELS = 8192
"""An 8K display; captures grow with the square of its focal length, and OpenGL draws 16384 pixels a side at most."""


@dataclass(frozen=True, slots=True)
class BuildParameters:
    """Parameters of a build; the defaults are the paper's experiment (section 6.1): 10 pixels of 512 x 512 at 60 degrees.

    Lengths are metres, angles radians. Raises ParameterError for values without meaning.
    """

    max_error_px: float = 10.0
    """Threshold T: how far what shares a layer may move apart, in pixels of ``camera``."""
    camera: Camera = field(default_factory=lambda: Camera(512, 512, math.radians(60.0)))
    near_distance: float = 30.0
    """Objects nearer to the cell than this stay geometry (unless ``near_triangles`` is given)."""
    near_triangles: int | None = None
    """A budget: the nearest objects stay geometry as long as they have no more triangles than this together."""
    longest_object: float | None = 40.0
    """Longer objects are cut into parts (:mod:`mmi.city.long_objects`); None cuts nothing."""
    steepest: float = 2.0
    """Objects that reach above this slope (height over distance) from the cell stay geometry."""
    visibility: str = "horizon"
    weights: _OwnOr = "same-ray"
    """``same-ray`` keeps the threshold (:mod:`mmi.parallax.ray_weights`), ``critical-zone`` and ``critical-zone-unsigned`` are
    the paper's. Or a function of one's own (:mod:`mmi.planning.choices`); it is kept as ``package.module:function@version``.
    """
    layering: _OwnOr = "best"
    """How objects are divided into layers (:mod:`mmi.planning.layering`); ``single`` puts all into one and keeps no bound. Or a
    function of one's own.
    """
    landmarks: tuple[tuple[str, float], ...] = ()
    """(object id, factor): weights of this object's pairs are multiplied by the factor (paper section 4.2)."""
    max_layers: int | None = None
    """A budget: layers. A cell that exceeds a budget is cut in halves (:mod:`mmi.building.halving`)."""
    max_triangles: int | None = None
    """A budget: triangles of near objects and layers together."""
    max_bytes: int | None = None
    """A budget: bytes of a cell's two files."""
    sectors: int = 6
    quad: int = 16
    """Texels: pictures of layers are cut to whole squares of this side."""
    supersample: int = 1
    texture_quality: int = 75
    """Quality of the stored pictures of layers, as WebP counts it; 100 is lossless. Coverage always is."""
    cell_length: float = 40.0
    eye: tuple[float, float] = (1.5, 1.9)
    near_stage: _OwnOr | None = None
    """What divides near from far (:mod:`mmi.planning.segmentation`): ``parallax``, ``distance``, which keeps no bound, or a
    function of one's own; None: what goes with the weights.
    """
    pictures: str = "all"
    """``none`` stores meshes and how they were captured, but no pictures, depths or ids (paper section 5.2): who draws the
    layers captures those from the city's geometry, with one sample a texel.
    """
    geometry: str = "near"
    """``cheaper`` keeps, beside near objects, all objects of a layer as geometry where that costs less than the layer, and all
    that is visible from a cell where that costs less than the cell's layers (:mod:`mmi.building.cheaper`).
    """
    costs: FrameCosts = field(default_factory=FrameCosts)
    """What is compared then, and what the manifest says that frames cost."""

    def __post_init__(self) -> None:
        try:
            self._check()
        except (TypeError, ValueError, AttributeError, IndexError) as error:
            raise ParameterError(
                f"parameters: numbers, names and functions as documented expected ({error})"
            ) from error

    def _check(self) -> None:
        """Raises ParameterError for what has no meaning, other errors for what is not even of the kind."""

        def expect(holds: bool, name: str, expected: str) -> None:
            if not holds:
                raise ParameterError(f"{name}: {expected} expected, found {getattr(self, name)!r}")

        for name in ("sectors", "quad", "supersample", "texture_quality"):
            expect(type(getattr(self, name)) is int, name, "a whole number")
        for name in ("near_triangles", "max_layers", "max_triangles", "max_bytes"):
            expect(getattr(self, name) is None or type(getattr(self, name)) is int, name, "a whole number, or none,")
        for name in ("max_error_px", "near_distance", "steepest", "cell_length"):
            object.__setattr__(self, name, _number(getattr(self, name), name))
        if self.longest_object is not None:
            object.__setattr__(self, "longest_object", _number(self.longest_object, "longest_object"))
        expect(
            max(self.camera.width, self.camera.height) <= _MOST_PIXELS and self.camera.focal <= _MOST_PIXELS,
            "camera",
            f"at most {_MOST_PIXELS} pixels a side and a focal length of at most {_MOST_PIXELS} pixels",
        )
        largest = 0.5 * min(self.camera.width, self.camera.height)
        expect(0.0 < self.max_error_px <= largest, "max_error_px", f"a number of pixels above 0 and up to {largest:g}")
        expect(0.0 < self.near_distance < math.inf, "near_distance", "a positive length in metres")
        expect(self.near_triangles is None or self.near_triangles >= 0, "near_triangles", "a number of 0 or more")
        longest = self.longest_object
        expect(longest is None or 10.0 <= longest < math.inf, "longest_object", "10 metres or more, or none,")
        for name in ("max_layers", "max_triangles", "max_bytes"):
            expect(getattr(self, name) is None or getattr(self, name) >= 1, name, "a number of 1 or more")
        expect(0.1 <= self.steepest <= 10.0, "steepest", "a slope from 0.1 to 10")
        expect(self.visibility in VISIBILITIES, "visibility", " or ".join(VISIBILITIES))
        expect(self.pictures in PICTURES, "pictures", " or ".join(PICTURES))
        expect(self.geometry in GEOMETRIES, "geometry", " or ".join(GEOMETRIES))
        expect(isinstance(self.costs, FrameCosts), "costs", "FrameCosts")
        for name, table in (("weights", WEIGHTS), ("layering", LAYERINGS), ("near_stage", NEAR_STAGES)):
            if name != "near_stage" or self.near_stage is not None:
                object.__setattr__(self, name, choose(table, getattr(self, name), what=name).text)
        expect(4 <= self.sectors <= 36, "sectors", "4 to 36 sectors")
        expect(8 <= self.quad <= 128 and self.quad % 8 == 0, "quad", "a multiple of 8 from 8 to 128")
        expect(self.supersample in (1, 3, 5), "supersample", "1, 3 or 5")
        expect(1 <= self.texture_quality <= 100, "texture_quality", "a quality from 1 to 100")
        expect(5.0 <= self.cell_length <= 500.0, "cell_length", "5 to 500 metres")
        expect(0.0 < self.eye[0] <= self.eye[1] < 100.0, "eye", "heights above the ground, low and high, in metres")
        if len({name for name, _ in self.landmarks}) < len(self.landmarks):
            raise ParameterError(f"landmark: one factor for each object expected, found {self.landmarks!r}")
        for name, factor in self.landmarks:
            if not name:
                raise ParameterError(f"landmark: an object's id expected, found none (factor {factor!r})")
            if not (factor >= 1.0 and math.isfinite(factor)):
                raise ParameterError(f"landmark {name}: a factor of 1 or more expected, found {factor!r}")

    @property
    def max_angle(self) -> float:
        """The threshold T in radians."""
        return self.camera.angle_from_pixels(self.max_error_px)

    @property
    def chosen_weights(self) -> Choice:
        """The weights."""
        return choose(WEIGHTS, self.weights, what="weights")

    @property
    def chosen_layering(self) -> Choice:
        """The layering."""
        return choose(LAYERINGS, self.layering, what="layering")

    @property
    def chosen_near_stage(self) -> Choice:
        """The near stage that was asked for, or else what goes with the weights."""
        return choose(NEAR_STAGES, self.near_stage or self.chosen_weights.near_stage, what="near_stage")

    @property
    def own_functions(self) -> tuple[str, ...]:
        """Choices that are functions from outside the package, as text: planning imports them, and so runs their code."""
        chosen = (self.chosen_weights, self.chosen_layering, self.chosen_near_stage)
        return tuple(one.text for one in chosen if one.version is not None)

    @property
    def bounded(self) -> bool:
        """Whether the choices bound what layers get wrong. Nothing is promised of functions from outside the package."""
        return self.chosen_weights.bounded and self.chosen_layering.bounded and self.chosen_near_stage.bounded

    def as_dict(self) -> dict[str, Any]:
        """For JSON: plain values in the same units. Near stage and pictures are named only where they are not the usual."""
        return {
            name: value for name, value in asdict(self).items() if name not in _LEFT_OUT or value != _LEFT_OUT[name]
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> BuildParameters:
        """The inverse of :meth:`as_dict`, after a trip through JSON too. Imports no functions from outside the package.

        Raises ParameterError where a name is missing or unknown, or a value is not what it should be.
        """
        names = {one.name for one in fields(cls)}
        if not isinstance(values, Mapping) or {*values, *_LEFT_OUT} != names:
            found = sorted(values) if isinstance(values, Mapping) else repr(values)
            raise ParameterError(f"parameters {sorted(names)} expected, found {found}")
        try:
            low, high = values["eye"]
            camera = Camera(**values["camera"])
            landmarks = tuple((str(name), float(factor)) for name, factor in values["landmarks"])
            costs = FrameCosts(**values["costs"])
            made = cls(**{**values, "camera": camera, "landmarks": landmarks, "eye": (low, high), "costs": costs})
        except (TypeError, ValueError) as error:
            raise ParameterError(f"parameters as stored by build-impostors expected, found others ({error})") from error
        for name, count in (
            ("width", camera.width),
            ("height", camera.height),
            ("near_triangles", made.near_triangles or 0),
            ("max_layers", made.max_layers or 0),
            ("max_triangles", made.max_triangles or 0),
            ("max_bytes", made.max_bytes or 0),
            ("sectors", made.sectors),
            ("quad", made.quad),
            ("supersample", made.supersample),
            ("texture_quality", made.texture_quality),
        ):
            if type(count) is not int:
                raise ParameterError(f"{name}: a whole number expected, found {count!r}")
        return made


def _number(value: object, name: str) -> float | int:
    """A number as Python's own, which JSON knows: NumPy's are others. Raises ParameterError."""
    if isinstance(value, bool | str) or not isinstance(value, SupportsFloat):
        raise ParameterError(f"{name}: a number expected, found {value!r}")
    return value if type(value) is int else float(value)
