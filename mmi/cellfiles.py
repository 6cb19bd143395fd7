"""A cell's impostor as files, and back: depth textures in one multi-part OpenEXR, meshes and textures in one binary glTF.

Part, node and texture of layer 2 in sector 0 are all named ``s0.l2``. The EXR holds, for other programs, colour (linear
half floats, alpha is coverage), Z (float, eye-space metres, infinite where nothing was hit) and id (unsigned: 0, or the
place of the object in the cell's list ``far``, from 1), in the capture's own pixel coordinates: its data window counts from
the principal point. The glTF holds what is drawn: vertices in the city's frame, colour dilated beyond silhouettes, coverage
as alpha. It also says how each texture was captured (``azimuth``, ``focal``, ``window``, ``eye``).
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from mmi.build import CellPlan, Scene
from mmi.camera import level_view
from mmi.cells import ViewingCell
from mmi.city import City
from mmi.dataset import Dataset, DatasetFolder
from mmi.errors import DatasetError
from mmi.glb import GlbImage, GlbNode, GlbPrimitive, GlbScene, glb_bytes, read_glb
from mmi.ground import ground_mesh
from mmi.impostor import DepthTexture, GridMesh, Impostor, Layer
from mmi.surfaces import CityMesh, build_city_mesh

__all__ = ["cell_entry", "city_glb", "read_impostor", "stored_cell", "write_cell_files"]

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


def write_cell_files(folder: DatasetFolder, city: City, impostor: Impostor) -> dict[str, Any]:
    """Write a cell's EXR and glTF; their checksum entries. Raises DatasetError where they cannot be written."""
    name = f"cells/{impostor.cell.id}"
    place = np.zeros(len(city.objects) + 1, dtype=np.uint32)  # object -1 is the last entry, and stays 0
    place[impostor.far] = np.arange(1, len(impostor.far) + 1)
    files = {"glb": folder.write(f"{name}.glb", glb_bytes(_scene(impostor)))}
    if impostor.layers:
        corners = np.array([layer.texture.view.window for layer in impostor.layers], dtype=np.int32)
        first, last = corners[:, :2].min(axis=0), (corners[:, :2] + corners[:, 2:]).max(axis=0) - 1
        parts = [_part(layer, place, (first, last)) for layer in impostor.layers]
        files["exr"] = folder.write_with(f"{name}.exr", lambda path: OpenEXR.File(parts).write(str(path)))
    return files


def cell_entry(
    scene: Scene, plan: CellPlan, impostor: Impostor, *, neighbours: Sequence[str], files: Mapping[str, Any]
) -> dict[str, Any]:
    """A cell's entry in the manifest (see schemas/manifest.json): plain values."""
    city, cell, camera = scene.city, impostor.cell, scene.parameters.camera
    far_place = {int(i): place for place, i in enumerate(impostor.far)}
    sectors: list[list[dict[str, Any]]] = [[] for _ in range(scene.parameters.sectors)]
    for layer in impostor.layers:
        sectors[layer.sector].append(
            {
                "name": _name(layer),
                "index": layer.index,
                "objects": [far_place[int(i)] for i in layer.objects],
                "focal": layer.texture.view.focal,
                "window": list(layer.texture.view.window),
                "triangles": len(layer.mesh.triangles),
            }
        )
    layer_of = {int(i): index for index, objects in enumerate(plan.layers) for i in objects}
    together = [layer_of[int(a)] == layer_of[int(b)] for a, b in plan.pairs]
    largest = float(np.max(plan.weights[together], initial=0.0))
    return {
        "id": cell.id,
        "street": cell.street,
        "axis": [list(cell.p), list(cell.q)],
        "half_width": cell.half_width,
        "eye": list(cell.eye),
        "reference": cell.reference.tolist(),
        "neighbours": list(neighbours),
        "near": [city.objects[i].id for i in impostor.near],
        "far": [city.objects[i].id for i in impostor.far],
        "layers": sectors,
        "triangles": sum(len(layer.mesh.triangles) for layer in impostor.layers),
        "near_triangles": int(scene.mesh.triangle_counts[impostor.near].sum()),
        "texels": sum(layer.texture.depth.size for layer in impostor.layers),
        "bytes": sum(file["bytes"] for file in files.values()),
        "promised_error_px": scene.parameters.max_error_px,
        "largest_weight_px": camera.pixels_from_angle(min(largest, 1.5)),
        "files": dict(files),
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
            layers.append(Layer(one["index"], sector, far[one["objects"]], texture, mesh))
    except (KeyError, ValueError, IndexError, TypeError, RuntimeError, OSError) as error:
        raise DatasetError(
            f"{name}: the layers that the manifest describes expected, found others ({error!r})"
        ) from error
    return Impostor(stored_cell(entry), near, far, tuple(layers))


def _name(layer: Layer) -> str:
    return f"s{layer.sector}.l{layer.index}"


def _part(
    layer: Layer, place: NDArray[np.uint32], display: tuple[NDArray[np.int32], NDArray[np.int32]]
) -> OpenEXR.Part:
    """One part of the EXR: RGBA, Z, id. All parts of a file have the same ``display`` window."""
    view, covered = layer.texture.view, layer.texture.coverage
    left, top, width, height = view.window
    rgba = np.zeros((height, width, 4), dtype=np.float16)
    rgba[..., :3] = _HALF_FROM_SRGB[layer.texture.color]
    rgba[~covered] = 0.0
    rgba[..., 3] = covered
    corner = np.array([left, top], dtype=np.int32)
    window = (corner, corner + np.array([width - 1, height - 1], dtype=np.int32))
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "dataWindow": window,
        "displayWindow": display,
        "focal": float(view.focal),
    }
    channels = {"RGBA": rgba, "Z": np.array(layer.texture.depth), "id": place[layer.texture.object_ids]}
    return OpenEXR.Part(header, channels, name=_name(layer))


def _scene(impostor: Impostor) -> GlbScene:
    """The glTF of a cell: a node a layer."""
    nodes, images = [], []
    for layer in impostor.layers:
        texture = layer.texture
        alpha = np.where(texture.coverage, 255, 0).astype(np.uint8)
        images.append(GlbImage(_png(np.dstack([texture.color, alpha]))))
        primitive = GlbPrimitive(
            layer.mesh.vertices, layer.mesh.triangles, uv=layer.mesh.uv, image=len(images) - 1, masked=True
        )
        extras = {"sector": layer.sector, "layer": layer.index, "focal": texture.view.focal}
        nodes.append(GlbNode(_name(layer), (primitive,), extras | {"window": list(texture.view.window)}))
    extras = {"cell": impostor.cell.id, "eye": impostor.cell.reference.tolist()}
    return GlbScene(tuple(nodes), tuple(images), extras)


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


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """Lossless, and quick rather than small."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, "PNG", compress_level=2)
    return buffer.getvalue()


def _half_from_srgb() -> NDArray[np.float16]:
    """(256,) linear light of each sRGB byte (IEC 61966-2-1); half floats tell all of them apart."""
    value = np.arange(256) / 255.0
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float16)
    linear.setflags(write=False)
    return linear


_HALF_FROM_SRGB = _half_from_srgb()
