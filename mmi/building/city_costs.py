"""What a city costs as it was read, as a dataset stores it, and as a frame draws it; and what all cells would cost, where some
were built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from mmi.appearance.city_mesh import build_city_mesh
from mmi.city.model import City
from mmi.dataset.manifest import CellEntry, Manifest

__all__ = ["CityCosts", "city_costs", "triangles_as_read"]


@dataclass(frozen=True, slots=True)
class CityCosts:
    """Triangles and bytes of a city and of a dataset of it; frames are means over its cells, in all directions.

    ``metres`` of street have cells in the dataset, ``all_metres`` could have; what is estimated for all is in proportion.
    """

    objects_read: int
    triangles_read: int
    objects: int
    triangles: int
    shared_bytes: int
    cells: int
    metres: float
    all_metres: float
    layer_triangles: int
    """Of all cells together."""
    cell_bytes: int
    """Of all cells together."""
    frame_triangles: float
    """As stored: near objects and layers."""
    frame_near: float
    """Of these, the near objects."""
    largest_frame: int
    geometry_triangles: float
    """Of a frame that draws all that may be visible as geometry."""
    as_geometry: int
    """Cells without layers."""
    worst_px: float | None
    """The largest weight, displacement or missed region of any cell; None where there are no cells."""

    @property
    def bytes_a_metre(self) -> float:
        """Bytes of cells for a metre of street."""
        return self.cell_bytes / self.metres if self.metres else 0.0

    @property
    def share(self) -> float:
        """The share of all cells, by length, that the dataset holds."""
        return min(self.metres / self.all_metres, 1.0) if self.all_metres else 1.0

    @property
    def estimated_bytes(self) -> float:
        """Bytes of a dataset of all cells."""
        return self.shared_bytes + (self.cell_bytes / self.share if self.share else 0.0)


def city_costs(manifest: Manifest, *, objects_read: int, triangles_read: int, all_metres: float) -> CityCosts:
    """The costs of a dataset; what was read is known to whoever has read it, and so is the length of all cells."""
    cells, city = manifest.cells, manifest.city
    return CityCosts(
        objects_read=objects_read,
        triangles_read=triangles_read,
        objects=city.objects,
        triangles=city.triangles,
        shared_bytes=city.files.json.bytes + city.files.glb.bytes,
        cells=len(cells),
        metres=sum(one.viewing_cell.length for one in cells),
        all_metres=all_metres,
        layer_triangles=sum(one.triangles for one in cells),
        cell_bytes=sum(one.bytes for one in cells),
        frame_triangles=_mean([one.near_triangles + one.triangles for one in cells]),
        frame_near=_mean([one.near_triangles for one in cells]),
        largest_frame=max((one.near_triangles + one.triangles for one in cells), default=0),
        geometry_triangles=_mean([one.frame.geometry.triangles for one in cells]),
        as_geometry=sum(_stays_geometry(one) for one in cells),
        worst_px=max((_worst(one) for one in cells), default=None),
    )


def triangles_as_read(read: City, stored: int, cut: City) -> int:
    """Triangles of the city as it was ``read``, where with its long objects ``cut`` it has ``stored`` ones."""
    if any(one.mesh is not None for one in read.objects):  # which may have been cut where its pictures repeat, too
        own = sum(len(one.mesh.triangles) for one in read.objects if one.mesh is not None)
        prisms = tuple(one for one in read.objects if one.mesh is None)
        return own + (len(build_city_mesh(replace(read, objects=prisms)).triangles) if prisms else 0)
    parts = {one.part_of for one in cut.objects if one.part_of is not None} - {one.part_of for one in read.objects}
    if not parts:
        return stored
    before = replace(read, objects=tuple(one for one in read.objects if one.id in parts))
    after = replace(cut, objects=tuple(one for one in cut.objects if one.part_of in parts))
    return stored + len(build_city_mesh(before).triangles) - len(build_city_mesh(after).triangles)


def _stays_geometry(entry: CellEntry) -> bool:
    """Whether all that can be seen from a cell is drawn as geometry."""
    return not entry.pictures and bool(entry.near) and not entry.far


def _worst(entry: CellEntry) -> float:
    return max(entry.largest_weight_px, entry.displacement_px, entry.missed_px or 0.0)


def _mean(values: Sequence[int]) -> float:
    return sum(values) / len(values) if values else 0.0
