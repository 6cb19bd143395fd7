"""Geometry templates of CityJSON: a shape that is there once and stands in many places, each with a matrix of its own.

Source: OGC CityJSON 2.0 (21-089), section 3.4.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.reading.city_models.cityjson_parts import points_of

__all__ = ["INSTANCE", "placed_template"]

INSTANCE = "GeometryInstance"
"""The type of a geometry that names a template."""


def placed_template(
    templates: Any,  # noqa: ANN401
    instance: Mapping[str, Any],
    points: NDArray[np.float64],
    first: int,
) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """The template that ``instance`` names as a geometry of its own, and its points (k, 3).

    ``points`` (n, 3) are those of the feature, among which is the reference point, and ``first`` is the place that the first
    of the new points will have. ``templates`` is the document's member ``geometry-templates``.

    Raises:
        KeyError, TypeError, ValueError, IndexError, AttributeError: they are not as CityJSON describes them.
    """
    number, (reference,) = instance["template"], instance["boundaries"]
    shapes = templates["templates"]
    if not (type(number) is int and 0 <= number < len(shapes)):
        raise ValueError(f"template {str(number)[:20]} of {len(shapes)}")
    if not (type(reference) is int and 0 <= reference < len(points)):
        raise ValueError(f"vertex {str(reference)[:20]} of {len(points)}")
    matrix = np.array(instance.get("transformationMatrix", np.eye(4)), dtype=np.float64).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise ValueError("transformationMatrix: 16 finite numbers expected")
    shape = shapes[number]
    used: dict[int, int] = {}
    boundaries = _renumbered(shape["boundaries"], used, first)
    own = points_of(templates["vertices-templates"])
    if used and not (min(used) >= 0 and max(used) < len(own) and np.isfinite(own[list(used)]).all()):
        raise ValueError(f"template {number}: vertices below {len(own)} of finite numbers expected")
    corners = own[list(used)] @ matrix[:3, :3].T + matrix[:3, 3] + points[reference]
    return {**shape, "boundaries": boundaries}, corners


def _renumbered(boundaries: Any, used: dict[int, int], first: int) -> Any:  # noqa: ANN401
    """Nested boundaries with new places, counted from ``first`` as they come; ``used`` keeps which were which."""
    if isinstance(boundaries, list):
        return [_renumbered(one, used, first) for one in boundaries]
    if type(boundaries) is not int:
        raise TypeError(f"a whole number expected, found {str(boundaries)[:20]}")
    return first + used.setdefault(boundaries, len(used))
