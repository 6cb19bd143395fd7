"""A cell's impostor as files, and back: depth textures in one multi-part OpenEXR, meshes and textures in one binary glTF.

Part, node and texture of layer 2 in sector 0 are all named ``s0.l2``, and ``s0.l2.1`` where it has a second picture there.
The EXR holds, for other programs, colour (linear half floats, alpha is coverage), Z (float, eye-space metres, infinite where
nothing was hit) and id (unsigned: 0, or the place of the object in the cell's list ``far``, from 1), in the capture's own
pixel coordinates: its data window counts from the principal point. The glTF holds what is drawn: vertices in the city's
frame, colour dilated beyond silhouettes, coverage as alpha. It also says how each texture was captured (``sector``,
``focal``, ``window``, ``eye``).
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numba import njit
from numpy.typing import NDArray
from PIL import Image

from mmi.build import CellPlan, Scene, Stopwatch
from mmi.camera import level_view
from mmi.cells import ViewingCell
from mmi.city import City
from mmi.dataset import Dataset, DatasetFolder
from mmi.errors import DatasetError
from mmi.glb import GlbImage, GlbNode, GlbPrimitive, GlbScene, glb_bytes, read_glb
from mmi.ground import ground_mesh
from mmi.impostor import DepthTexture, GridMesh, Impostor, Layer
from mmi.srgb import linear_from_srgb
from mmi.surfaces import CityMesh, build_city_mesh

__all__ = ["city_glb", "read_city_mesh", "read_impostor", "stored_cell", "write_cell"]

_GROUND_MARGIN = 300.0


def city_glb(city: City) -> tuple[bytes, int]:
    """The geometry that all cells share as binary glTF, and its triangles: a node an object, named by id, and ``ground``."""
    mesh, ground = build_city_mesh(city), ground_mesh(city, margin=_GROUND_MARGIN)
    nodes = [
        GlbNode(one.id, _primitives(mesh, i, image=0), {"base": one.base, "top": one.top})
        for i, one in enumerate(city.objects)
    ]
    nodes.append(GlbNode("ground", _primitives(ground, 0, image=1)))
    images = (GlbImage(_png(mesh.texture), repeat=True), GlbImage(_png(ground.texture), repeat=True))
    scene = GlbScene(tuple(nodes), images, {"crs": city.crs, "origin": list(city.origin), "source": city.source})
    return glb_bytes(scene), len(mesh.triangles)


def read_city_mesh(dataset: Dataset) -> tuple[CityMesh, CityMesh]:
    """The geometry of all objects, in the city's order, and of the ground. Raises DatasetError when its file is damaged."""
    entry = dataset.manifest["city"]["files"]["glb"]
    name = str(dataset.path / entry["name"])
    scene = read_glb(dataset.read(entry), name=name)
    try:
        *objects, ground = scene.nodes
        return _city_mesh(objects, scene.images[0]), _city_mesh([ground], scene.images[1])
    except (ValueError, IndexError, OSError) as error:
        raise DatasetError(f"{name}: objects, ground and two textures expected, found others ({error})") from error


def write_cell(
    folder: DatasetFolder,
    scene: Scene,
    plan: CellPlan,
    layers: Iterable[Layer],
    *,
    neighbours: Sequence[str],
    watch: Stopwatch,
) -> dict[str, Any]:
    """Write a cell's EXR and glTF as its ``layers`` come, and return its entry in the manifest (schemas/manifest.json).

    No more than one layer is held as it was captured. Raises DatasetError where the files cannot be written.
    """
    selection, city, cell = plan.selection, scene.city, plan.selection.cell
    place = np.zeros(len(city.objects) + 1, dtype=np.uint32)  # object -1 is the last entry, and stays 0
    place[selection.far] = np.arange(1, len(selection.far) + 1)
    sectors: list[list[dict[str, Any]]] = [[] for _ in range(scene.parameters.sectors)]
    nodes: list[GlbNode] = []
    images: list[GlbImage] = []
    parts: list[OpenEXR.Part] = []
    texels = 0
    for layer in layers:
        with watch.stage("encoding"):
            nodes.append(_node(layer, image=len(images)))
            images.append(_image(layer))
            parts.append(_part(layer, place))
            sectors[layer.sector].append(_layer_entry(layer, place))
            texels += layer.texture.depth.size
    with watch.stage("writing"):
        extras = {"cell": cell.id, "eye": cell.reference.tolist()}
        gltf = glb_bytes(GlbScene(tuple(nodes), tuple(images), extras))
        files = {"glb": folder.write(f"cells/{cell.id}.glb", gltf)}
        if parts:
            files["exr"] = folder.write_with(f"cells/{cell.id}.exr", lambda path: _write_exr(path, parts))
    return {
        "id": cell.id,
        "street": cell.street,
        "axis": [list(cell.p), list(cell.q)],
        "half_width": cell.half_width,
        "eye": list(cell.eye),
        "reference": cell.reference.tolist(),
        "neighbours": list(neighbours),
        "near": [city.objects[i].id for i in selection.near],
        "far": [city.objects[i].id for i in selection.far],
        "layers": sectors,
        "triangles": sum(layer["triangles"] for sector in sectors for layer in sector),
        "near_triangles": int(scene.mesh.triangle_counts[selection.near].sum()),
        "texels": texels,
        "bytes": sum(file["bytes"] for file in files.values()),
        "promised_error_px": scene.parameters.max_error_px,
        "largest_weight_px": _largest_weight_px(scene, plan),
        "files": files,
    }


def stored_cell(entry: Mapping[str, Any]) -> ViewingCell:
    """The viewing cell of a manifest's entry."""
    (px, py), (qx, qy) = entry["axis"]
    low, high = entry["eye"]
    return ViewingCell(entry["id"], (px, py), (qx, qy), entry["half_width"], (low, high), entry["street"])


def read_impostor(dataset: Dataset, cell: str, city: City) -> Impostor:
    """A cell's impostor, as it was captured. Raises DatasetError when a file is missing, damaged or not what it should be."""
    entry = dataset.cell(cell)
    index = city.index()
    name = str(dataset.path / "cells" / f"{cell}.exr")
    try:
        near = np.array([index[one] for one in entry["near"]], dtype=np.int64)
        far = np.array([index[one] for one in entry["far"]], dtype=np.int64)
        described = [(sector, one) for sector, layers in enumerate(entry["layers"]) for one in layers]
        if not described:
            return Impostor(stored_cell(entry), near, far, ())
        scene = read_glb(dataset.read(entry["files"]["glb"]), name=name[:-3] + "glb")
        nodes = {node.name: node for node in scene.nodes}
        dataset.read(entry["files"]["exr"])  # for its checksum
        parts = {part.name(): part.channels for part in OpenEXR.File(name).parts}
        objects = np.concatenate([[-1], far])
        layers = []
        for sector, one in described:
            eye = np.array(entry["reference"])
            azimuth = 2.0 * np.pi / len(entry["layers"]) * sector
            view = level_view(eye, azimuth, focal=one["focal"], window=tuple(one["window"]))
            primitive = nodes[one["name"]].primitives[0]
            assert primitive.image is not None
            assert primitive.uv is not None
            with Image.open(io.BytesIO(scene.images[primitive.image].data)) as picture:
                color = np.array(picture.convert("RGB"))
            channels = parts[one["name"]]
            texture = DepthTexture(
                view,
                color,
                np.array(channels["Z"].pixels),
                objects[channels["id"].pixels].astype(np.int32),
            )
            mesh = GridMesh(primitive.positions, primitive.uv, primitive.triangles)
            layers.append(Layer(one["index"], sector, one["part"], far[one["objects"]], texture, mesh))
    except (KeyError, ValueError, IndexError, TypeError, RuntimeError, OSError) as error:
        raise DatasetError(
            f"{name}: the layers that the manifest describes expected, found others ({error!r})"
        ) from error
    return Impostor(stored_cell(entry), near, far, tuple(layers))


def _layer_entry(layer: Layer, place: NDArray[np.uint32]) -> dict[str, Any]:
    return {
        "name": layer.name,
        "index": layer.index,
        "part": layer.part,
        "objects": [int(place[i]) - 1 for i in layer.objects],
        "focal": layer.texture.view.focal,
        "window": list(layer.texture.view.window),
        "triangles": len(layer.mesh.triangles),
    }


def _largest_weight_px(scene: Scene, plan: CellPlan) -> float:
    """The largest weight of a pair that shares a layer, in pixels at the centre of the display."""
    layer_of = {int(i): index for index, objects in enumerate(plan.layers) for i in objects}
    together = np.array([layer_of[int(a)] == layer_of[int(b)] for a, b in plan.pairs], dtype=bool)
    largest = float(np.max(plan.weights[together], initial=0.0))
    return scene.parameters.camera.pixels_from_angle(min(largest, 1.5))


def _part(layer: Layer, place: NDArray[np.uint32]) -> OpenEXR.Part:
    """One part of the EXR: RGBA, Z, id."""
    texture, covered = layer.texture, layer.texture.coverage
    left, top, width, height = texture.view.window
    rgba = _half_rgba(texture.color, covered, _HALF_FROM_SRGB.view(np.uint16)).view(np.float16)
    corner = np.array([left, top], dtype=np.int32)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": (corner, corner + np.array([width - 1, height - 1], dtype=np.int32)),
        "focal": float(texture.view.focal),
    }
    channels = {"RGBA": rgba, "Z": np.array(texture.depth), "id": place[texture.object_ids]}
    return OpenEXR.Part(header, channels, name=layer.name)


@njit(cache=True)
def _half_rgba(
    color: NDArray[np.uint8], covered: NDArray[np.bool_], half_from_srgb: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """(h, w, 4) bits of half floats: linear colour and 1 where covered, 0 elsewhere."""
    rgba = np.zeros((*covered.shape, 4), dtype=np.uint16)
    for i in range(covered.shape[0]):
        for j in range(covered.shape[1]):
            if covered[i, j]:
                for k in range(3):
                    rgba[i, j, k] = half_from_srgb[color[i, j, k]]
                rgba[i, j, 3] = 0x3C00  # 1.0
    return rgba


def _write_exr(path: Path, parts: list[OpenEXR.Part]) -> None:
    """One file of several parts, which must share their display window."""
    windows = np.array([part.header["dataWindow"] for part in parts])
    display = (windows[:, 0].min(axis=0), windows[:, 1].max(axis=0))
    for part in parts:
        part.header["displayWindow"] = display
    OpenEXR.File(parts).write(str(path))


def _image(layer: Layer) -> GlbImage:
    """Colour, dilated beyond the silhouette, and coverage as alpha."""
    pixels = np.empty((*layer.texture.depth.shape, 4), dtype=np.uint8)
    pixels[..., :3] = layer.texture.color
    pixels[..., 3] = np.where(layer.texture.coverage, 255, 0)
    return GlbImage(_png(pixels))


def _node(layer: Layer, *, image: int) -> GlbNode:
    """A layer's mesh, and how its texture was captured."""
    mesh, view = layer.mesh, layer.texture.view
    primitive = GlbPrimitive(mesh.vertices, mesh.triangles, uv=mesh.uv, image=image, masked=True)
    extras = {
        "sector": layer.sector,
        "layer": layer.index,
        "part": layer.part,
        "focal": view.focal,
        "window": list(view.window),
    }
    return GlbNode(layer.name, (primitive,), extras)


def _primitives(mesh: CityMesh, index: int, *, image: int) -> tuple[GlbPrimitive, ...]:
    """The part of ``mesh`` that object ``index`` owns; nothing where it has no triangles."""
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
        texture = np.array(picture.convert("RGB"))
    return CityMesh(
        positions=np.concatenate([part.positions for part in found]),
        uv=np.concatenate([part.uv for part in found if part.uv is not None]),
        colors=np.concatenate([part.colors for part in found if part.colors is not None]),
        triangles=np.concatenate([part.triangles + np.int32(start) for part, start in zip(found, first, strict=True)]),
        object_vertices=vertices.astype(np.int64),
        object_triangles=triangles.astype(np.int64),
        texture=texture,
    )


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """Lossless, and quick rather than small."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _half_from_srgb() -> NDArray[np.float16]:
    """(256,) linear light of each sRGB byte; half floats tell all of them apart."""
    linear = linear_from_srgb(np.arange(256, dtype=np.uint8)).astype(np.float16)
    linear.setflags(write=False)
    return linear


_HALF_FROM_SRGB = _half_from_srgb()
