"""A cell's impostor as files, and back: depth textures in one multi-part OpenEXR, meshes and textures in one binary glTF.

Part, node and texture of layer 2 in sector 0 are all named ``s0.l2``, and ``s0.l2.1`` where it has a second picture there.
The glTF holds what is drawn: vertices in the city's frame, and a WebP picture of colour, dilated beyond silhouettes, with
coverage as alpha (lossless, whatever the quality of the colour). It also says how each texture was captured (``sector``,
``focal``, ``window``, ``eye``). The EXR holds the rest of the depth textures: Z (half, eye-space metres, infinite where nothing
was hit) and id (unsigned: 0, or the place of the object in the cell's lists ``far`` and then ``near``, from 1), in the pixel
coordinates of the capture: its data window counts from the principal point. Who only draws reads the glTF alone
(:func:`read_pictures`); depth and ids are for measuring and for telling which of two layers is in front (:func:`read_depths`).
A node's first ``plain`` triangles (the manifest says how many) can be drawn as they are, without depth
(:mod:`mmi.meshing.ordering`).

The city's geometry, which all cells share, is one more glTF: nodes of objects, then tiles of the ground.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from mmi.appearance.city_mesh import triangles_of
from mmi.capture.layer_values import DepthTexture, GridMesh, Impostor, Layer, LayerPicture
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.dataset.folder import DatasetFolder
from mmi.dataset.glb import GlbImage, GlbNode, GlbPrimitive, GlbScene, glb_bytes, read_glb
from mmi.dataset.reading import Dataset
from mmi.foundation.camera import View, level_view
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.stopwatch import Stopwatch
from mmi.meshing.ordering import CapturedLayer, out_of_order
from mmi.planning.plan import CellPlan, PreparedCity

__all__ = ["captured_view", "read_depths", "read_impostor", "read_pictures", "stored_cell", "write_cell"]

_TILE = 512


def write_cell(
    folder: DatasetFolder,
    scene: PreparedCity,
    plan: CellPlan,
    layers: Iterable[Layer],
    *,
    neighbours: Sequence[str],
    watch: Stopwatch,
) -> dict[str, Any]:
    """Write a cell's EXR and glTF as its ``layers`` come, and return its entry in the manifest (schemas/manifest.json).

    Of all layers but the one at hand, only depth is held as it was captured. Raises DatasetError where files cannot be written.
    """
    selection, city, cell = plan.selection, scene.city, plan.selection.cell
    place = np.zeros(len(city.objects) + 1, dtype=np.uint32)  # object -1 is the last entry, and stays 0
    listed = np.concatenate([selection.far, selection.near])
    place[listed] = np.arange(1, len(listed) + 1)
    sectors: list[list[dict[str, Any]]] = [[] for _ in range(scene.parameters.sectors)]
    entries: list[dict[str, Any]] = []
    captured: list[CapturedLayer] = []
    nodes: list[GlbNode] = []
    images: list[GlbImage] = []
    parts: list[OpenEXR.Part] = []
    texels, displaced = 0, 0.0
    for layer in layers:
        with watch.stage("encoding"):
            nodes.append(_node(layer, image=len(images)))
            images.append(_image(layer, scene.parameters.texture_quality))
            parts.append(_part(layer, place))
            captured.append(CapturedLayer(layer.index, layer.texture.view, layer.mesh, layer.texture.depth))
            entries.append(_layer_entry(layer, place))
            sectors[layer.sector].append(entries[-1])
            texels += layer.texture.depth.size
            displaced = max(displaced, layer.displacement)
    with watch.stage("ordering"):
        _put_in_order(nodes, entries, captured, scene, plan)
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
        "rise": cell.rise,
        "reference": cell.reference.tolist(),
        "neighbours": list(neighbours),
        "near": [city.objects[i].id for i in selection.near],
        "far": [city.objects[i].id for i in selection.far],
        "layers": sectors,
        "triangles": sum(layer["triangles"] for sector in sectors for layer in sector),
        "near_triangles": int(scene.mesh.triangle_counts[selection.near].sum()),
        "texels": texels,
        "bytes": sum(file["bytes"] for file in files.values()),
        "promised_error_px": scene.parameters.max_error_px if scene.parameters.bounded else None,
        "largest_weight_px": _largest_weight_px(scene, plan),
        "missed_px": plan.missed,
        "displacement_px": scene.parameters.camera.pixels_from_angle(min(displaced, 1.5)),
        "files": files,
    }


def stored_cell(entry: Mapping[str, Any]) -> ViewingCell:
    """The viewing cell of a manifest's entry."""
    (px, py), (qx, qy) = entry["axis"]
    low, high = entry["eye"]
    return ViewingCell(
        entry["id"], (px, py), (qx, qy), entry["half_width"], (low, high), entry["street"], entry["rise"]
    )


def captured_view(entry: Mapping[str, Any], sector: int, layer: Mapping[str, Any]) -> View:
    """The view in which a layer of a sector was captured, from the entries of cell and layer in the manifest."""
    azimuth = 2.0 * np.pi / len(entry["layers"]) * sector
    return level_view(np.array(entry["reference"]), azimuth, focal=layer["focal"], window=tuple(layer["window"]))


def read_pictures(dataset: Dataset, cell: str) -> tuple[LayerPicture, ...]:
    """All that it takes to draw a cell's layers, in the manifest's order, from its glTF alone.

    Raises DatasetError when there is no such cell, or its file is missing, damaged or not what the manifest describes.
    """
    entry = dataset.cell(cell)
    described = _described(entry)
    if not described:
        return ()
    name = str(dataset.path / entry["files"]["glb"]["name"])
    scene = read_glb(dataset.read(entry["files"]["glb"]), name=name)
    with _as_described(name):
        nodes = {node.name: node for node in scene.nodes}
        return tuple(_picture(entry, sector, one, nodes[one["name"]], scene.images) for sector, one in described)


def read_depths(dataset: Dataset, cell: str) -> dict[str, tuple[NDArray[np.float32], NDArray[np.uint32]]]:
    """What a cell's layers were captured as, from its EXR: name of the layer -> depth and places.

    Depth (h, w) is eye-space metres, ``inf`` where nothing was hit; places (h, w) are 0 there, elsewhere the place of the
    object in the cell's lists ``far`` and then ``near``, from 1.
    Raises DatasetError when there is no such cell, or its file is missing, damaged or not what the manifest describes.
    """
    entry = dataset.cell(cell)
    described = _described(entry)
    if not described:
        return {}
    name = str(dataset.path / entry["files"]["exr"]["name"])
    dataset.read(entry["files"]["exr"])  # for its checksum
    found, objects = {}, len(entry["far"]) + len(entry["near"])
    with _as_described(name):
        parts = {part.name(): part.channels for part in OpenEXR.File(name).parts}
        for _, one in described:
            channels, shape = parts[one["name"]], (one["window"][3], one["window"][2])
            depth, places = channels["Z"].pixels.astype(np.float32), np.array(channels["id"].pixels)
            if depth.shape != shape or places.shape != shape or places.max() > objects:
                raise ValueError(f"{one['name']}: depths and places of {objects} objects, {shape}, expected")
            found[one["name"]] = depth, places
    return found


def read_impostor(dataset: Dataset, cell: str, city: City) -> Impostor:
    """A cell's impostor, as it was captured. Raises DatasetError when a file is missing, damaged or not what it should be."""
    entry = dataset.cell(cell)
    pictures, depths = read_pictures(dataset, cell), read_depths(dataset, cell)
    index = city.index()
    with _as_described(str(dataset.path / "manifest.json")):
        near = np.array([index[one] for one in entry["near"]], dtype=np.int64)
        far = np.array([index[one] for one in entry["far"]], dtype=np.int64)
        objects = np.concatenate([[-1], far, near]).astype(np.int32)
        layers = []
        for picture, (_, one) in zip(pictures, _described(entry), strict=True):
            depth, places = depths[picture.name]
            color = np.ascontiguousarray(picture.pixels[..., :3])
            texture = DepthTexture(picture.view, color, depth, objects[places])
            shown = far[one["objects"]]
            layers.append(Layer(picture.index, picture.sector, picture.part, shown, texture, picture.mesh))
    return Impostor(stored_cell(entry), near, far, tuple(layers))


def _described(entry: Mapping[str, Any]) -> list[tuple[int, Mapping[str, Any]]]:
    """(sector, entry) of each picture of a layer that a cell's entry in the manifest lists."""
    return [(sector, one) for sector, layers in enumerate(entry["layers"]) for one in layers]


@contextmanager
def _as_described(name: str) -> Iterator[None]:
    """Turns what goes wrong while a file's contents are held against the manifest into a DatasetError."""
    try:
        yield
    except (KeyError, ValueError, IndexError, TypeError, RuntimeError, OSError, ParameterError) as error:
        raise DatasetError(
            f"{name}: the layers that the manifest describes expected, found others ({error!r})"
        ) from error


def _picture(
    entry: Mapping[str, Any], sector: int, one: Mapping[str, Any], node: GlbNode, images: Sequence[GlbImage]
) -> LayerPicture:
    """The inverse of :func:`_node` and :func:`_image`. Raises ValueError where node and manifest do not agree."""
    view = captured_view(entry, sector, one)
    extras = _extras(one["index"], sector, one["part"], view)
    if node.extras != extras:
        raise ValueError(f"{node.name}: {extras} expected, found {node.extras}")
    (primitive,) = node.primitives
    if primitive.image is None or primitive.uv is None or len(primitive.triangles) != one["triangles"]:
        raise ValueError(f"{node.name}: a texture and {one['triangles']} triangles expected")
    if not 0 <= one["plain"] <= one["triangles"]:
        raise ValueError(f"{node.name}: at most {one['triangles']} plain triangles expected, found {one['plain']}")
    with Image.open(io.BytesIO(images[primitive.image].data), formats=("WEBP",)) as picture:
        pixels = np.array(picture)
    mesh = GridMesh(primitive.positions, primitive.uv, primitive.triangles)
    return LayerPicture(one["name"], one["index"], sector, one["part"], view, pixels, mesh, one["plain"])


def _put_in_order(
    nodes: list[GlbNode],
    entries: list[dict[str, Any]],
    captured: Sequence[CapturedLayer],
    scene: PreparedCity,
    plan: CellPlan,
) -> None:
    """Put triangles of ``nodes`` that need captured depths last (:mod:`mmi.meshing.ordering`); ``entries`` say how many do
    not.
    """
    cell, city = plan.selection.cell, scene.city
    flags = out_of_order(
        captured,
        max_angle=scene.parameters.max_angle,
        eye_height=max(float(cell.reference[2] - city.ground_at(cell.reference)), 0.0),
        solids=scene.mesh.positions[triangles_of(scene.mesh, plan.selection.near)] - cell.reference,
        terrain=city.terrain,
    )
    for k, (node, late) in enumerate(zip(nodes, flags, strict=True)):
        (primitive,) = node.primitives
        in_order = primitive.triangles[np.argsort(late, kind="stable")]
        nodes[k] = replace(node, primitives=(replace(primitive, triangles=in_order),))
        entries[k]["plain"] = int(np.count_nonzero(~late))


def _layer_entry(layer: Layer, place: NDArray[np.uint32]) -> dict[str, Any]:
    depths = layer.texture.view.project(layer.mesh.vertices.astype(np.float64))[:, 2]
    return {
        "name": layer.name,
        "index": layer.index,
        "part": layer.part,
        "objects": [int(place[i]) - 1 for i in layer.objects],
        "focal": layer.texture.view.focal,
        "window": list(layer.texture.view.window),
        "triangles": len(layer.mesh.triangles),
        "depth": [float(depths.min()), float(depths.max())],
    }


def _largest_weight_px(scene: PreparedCity, plan: CellPlan) -> float:
    """The largest weight of a pair that shares a layer, or self-parallax, in pixels at the centre of the display."""
    layer_of = {int(i): index for index, objects in enumerate(plan.layers) for i in objects}
    together = np.array([layer_of[int(a)] == layer_of[int(b)] for a, b in plan.pairs], dtype=bool)
    largest = float(np.max(plan.weights[together], initial=0.0))
    selection = plan.selection
    if selection.parallax is not None:
        largest = float(np.max(selection.parallax[np.isin(selection.objects, selection.far)], initial=largest))
    return scene.parameters.camera.pixels_from_angle(min(largest, 1.5))


def _part(layer: Layer, place: NDArray[np.uint32]) -> OpenEXR.Part:
    """One part of the EXR: Z and id."""
    left, top, width, height = layer.texture.view.window
    corner = np.array([left, top], dtype=np.int32)
    tiles = OpenEXR.TileDescription()  # one or few: each is compressed on its own
    tiles.xSize = tiles.ySize = _TILE
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": tiles,
        "dataWindow": (corner, corner + np.array([width - 1, height - 1], dtype=np.int32)),
        "focal": float(layer.texture.view.focal),
    }
    channels = {"Z": layer.texture.depth.astype(np.float16), "id": place[layer.texture.object_ids]}
    return OpenEXR.Part(header, channels, name=layer.name)


def _write_exr(path: Path, parts: list[OpenEXR.Part]) -> None:
    """One file of several parts, which must share their display window."""
    windows = np.array([part.header["dataWindow"] for part in parts])
    display = (windows[:, 0].min(axis=0), windows[:, 1].max(axis=0))
    for part in parts:
        part.header["displayWindow"] = display
    OpenEXR.File(parts).write(str(path))


def _image(layer: Layer, quality: int) -> GlbImage:
    """Colour, dilated beyond the silhouette, and coverage as alpha."""
    pixels = np.empty((*layer.texture.depth.shape, 4), dtype=np.uint8)
    pixels[..., :3] = layer.texture.color
    pixels[..., 3] = np.where(layer.texture.coverage, 255, 0)
    buffer = io.BytesIO()
    options = {"lossless": True, "quality": 0} if quality == 100 else {"quality": quality}
    Image.fromarray(pixels).save(buffer, "WEBP", method=2, exact=True, **options)
    return GlbImage(buffer.getvalue())


def _node(layer: Layer, *, image: int) -> GlbNode:
    """A layer's mesh, and how its texture was captured."""
    mesh = layer.mesh
    primitive = GlbPrimitive(mesh.vertices, mesh.triangles, uv=mesh.uv, image=image, masked=True)
    return GlbNode(layer.name, (primitive,), _extras(layer.index, layer.sector, layer.part, layer.texture.view))


def _extras(index: int, sector: int, part: int, view: View) -> dict[str, Any]:
    """What the glTF says of a layer's picture, besides what is drawn."""
    return {"sector": sector, "layer": index, "part": part, "focal": view.focal, "window": list(view.window)}
