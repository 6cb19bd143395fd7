"""The city's geometry, which all cells share, as one binary glTF: nodes of objects, then tiles of the ground."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mmi import limits
from mmi.appearance.city_mesh import CityMesh, build_city_mesh
from mmi.appearance.cut_outs import clear_blocks, cut_out_triangles
from mmi.appearance.ground_mesh import ground_mesh
from mmi.city.model import City
from mmi.dataset.glb import GlbContents, GlbImage, GlbNode, GlbPrimitive, glb_bytes, read_glb
from mmi.dataset.reading import Dataset
from mmi.foundation.errors import DatasetError
from mmi.foundation.srgb import png_bytes

__all__ = ["city_glb", "city_meshes", "read_city_mesh"]

_GROUND_MARGIN = 300.0


def city_meshes(city: City) -> tuple[CityMesh, CityMesh]:
    """The geometry that all cells of a dataset share, without a dataset: what :func:`read_city_mesh` reads from one."""
    return build_city_mesh(city), ground_mesh(city, margin=_GROUND_MARGIN)


def city_glb(city: City) -> tuple[bytes, int]:
    """The geometry that all cells share as binary glTF, and the number of the objects' triangles.

    Nodes are the objects in the city's order, named by id, and then the tiles of the ground: ``ground/0``, ``ground/1``, ...
    Those that show cut-outs have a material with holes.
    """
    mesh, ground = city_meshes(city)
    cut_out = cut_out_triangles(clear_blocks(mesh.texture), mesh.uv, mesh.triangles)
    nodes = [
        GlbNode(one.id, _primitives(mesh, i, image=0, cut_out=cut_out), {"base": one.base, "top": one.top})
        for i, one in enumerate(city.objects)
    ]
    tiles = range(len(ground.triangle_counts))
    nodes += [GlbNode(f"ground/{i}", _primitives(ground, i, image=1)) for i in tiles]
    images = tuple(GlbImage(png_bytes(one.texture, quick=True), repeat=True) for one in (mesh, ground))
    contents = GlbContents(tuple(nodes), images, {"crs": city.crs, "origin": list(city.origin), "source": city.source})
    return glb_bytes(contents), len(mesh.triangles)


def read_city_mesh(dataset: Dataset) -> tuple[CityMesh, CityMesh]:
    """The geometry of all objects, in the city's order, and of the ground, an object a tile
    (:func:`mmi.appearance.ground_mesh.ground_mesh`).

    Raises DatasetError when its file is missing or damaged.
    """
    entry = dataset.manifest.city.files.glb
    name = str(dataset.path / entry.name)
    contents = read_glb(dataset.read(entry), name=name)
    objects = dataset.manifest.city.objects  # counted, as an object may be called ground/0 too
    try:
        city, ground = contents.nodes[:objects], contents.nodes[objects:]
        return _city_mesh(city, contents.images[0]), _city_mesh(ground, contents.images[1])
    except (ValueError, IndexError, OSError, Image.DecompressionBombError) as error:
        raise DatasetError(f"{name}: objects, ground and two textures expected, found others ({error})") from error


def _primitives(
    mesh: CityMesh, index: int, *, image: int, cut_out: NDArray[np.bool_] | None = None
) -> tuple[GlbPrimitive, ...]:
    """The part of ``mesh`` that object ``index`` owns; nothing where it has no triangles. ``cut_out`` (m,) of all triangles."""
    first, last = mesh.object_vertices[index : index + 2]
    start, end = mesh.object_triangles[index : index + 2]
    if start == end:
        return ()
    return (
        GlbPrimitive(
            mesh.positions[first:last],
            mesh.triangles[start:end] - np.int32(first),
            uv=mesh.uv[first:last],
            colors=mesh.colors[first:last],
            image=image,
            cut_out=cut_out is not None and bool(cut_out[start:end].any()),
        ),
    )


def _city_mesh(nodes: Sequence[GlbNode], image: GlbImage) -> CityMesh:
    """The inverse of :func:`_primitives` for all objects."""
    parts = [node.primitives[0] if node.primitives else None for node in nodes]
    found = [part for part in parts if part is not None]
    vertices = np.concatenate([[0], np.cumsum([0 if part is None else len(part.positions) for part in parts])])
    triangles = np.concatenate([[0], np.cumsum([0 if part is None else len(part.triangles) for part in parts])])
    first = [int(vertices[i]) for i, part in enumerate(parts) if part is not None]
    with Image.open(io.BytesIO(image.data)) as picture:
        if picture.width * picture.height > limits.PICTURE_PIXELS:
            raise ValueError(f"a texture of {picture.width} x {picture.height} pixels")
        texture = np.array(picture.convert("RGBA" if picture.mode == "RGBA" else "RGB"))
    return CityMesh(
        positions=np.concatenate([part.positions for part in found]),
        uv=np.concatenate([part.uv for part in found if part.uv is not None]),
        colors=np.concatenate([part.colors for part in found if part.colors is not None]),
        triangles=np.concatenate([part.triangles + np.int32(start) for part, start in zip(found, first, strict=True)]),
        object_vertices=vertices.astype(np.int64),
        object_triangles=triangles.astype(np.int64),
        texture=texture,
    )
