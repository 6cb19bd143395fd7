"""A cell's impostor as files, and back: depth textures in one multi-part OpenEXR, meshes and textures in one binary glTF.

Part, node and texture of layer 2 in sector 0 are all named ``s0.l2``, and ``s0.l2.1`` where it has a second piece there.
The glTF holds what is drawn: vertices in the city's frame, and a WebP picture of colour, dilated beyond silhouettes, with
coverage as alpha (lossless, whatever the quality of the colour). It also says how each texture was captured (``sector``,
``focal``, ``window``, ``eye``). The EXR holds the rest of the depth textures: Z (half, eye-space metres, infinite where nothing
was hit) and id (unsigned: 0, or the place of the object in the cell's lists ``far`` and then ``near``, from 1), in the pixel
coordinates of the capture: its data window counts from the principal point. Who only draws reads the glTF alone
(:func:`read_pictures`); depth and ids are for measuring and for telling which of two layers is in front (:func:`read_depths`).
A dataset may hold no pictures (``pictures`` of the parameters is ``none``). A glTF then has meshes alone, whose texture
coordinates are those of the pictures that its extras describe; there is no EXR, and :func:`read_meshes` reads what there is.
A node's first ``in_order`` triangles (the manifest says how many) can be drawn as they are, without depth
(:mod:`mmi.meshing.ordering`).
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image

from mmi.capture.layer_values import DepthTexture, GridMesh, Impostor, Layer, LayerMesh, LayerPicture, Promise
from mmi.city.model import City
from mmi.dataset.folder import DatasetFolder
from mmi.dataset.glb import GlbContents, GlbImage, GlbNode, GlbPrimitive, glb_bytes, read_glb
from mmi.dataset.manifest import CellEntry, CellFiles, FrameEntry, LayerEntry, LoadEntry
from mmi.dataset.reading import Dataset
from mmi.foundation.camera import Camera, View
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.planning.frame_costs import FrameCosts, FrameLoad

__all__ = ["read_depths", "read_impostor", "read_meshes", "read_pictures", "write_cell"]

_TILE = 512


def write_cell(
    folder: DatasetFolder,
    impostor: Impostor,
    ids: Sequence[str],
    *,
    camera: Camera,
    neighbours: Sequence[str],
    costs: FrameCosts,
    quality: int = 75,
    pictures: bool = True,
) -> CellEntry:
    """Write a cell's glTF and, with ``pictures``, its EXR; its entry in the manifest. Without, the glTF has meshes alone.

    ``ids`` are those of the city's objects, ``camera`` is the display that pixels are of, ``costs`` tell what a frame costs,
    ``quality`` is that of WebP (100 is lossless).
    An EXR of an earlier build is removed where the cell has none now. Raises DatasetError where files cannot be
    written.
    """
    cell, promise = impostor.cell, impostor.promise
    place = np.zeros(len(ids) + 1, dtype=np.uint32)  # object -1 is the last entry, and stays 0
    listed = np.concatenate([impostor.far, impostor.near])
    place[listed] = np.arange(1, len(listed) + 1)
    sectors: list[list[LayerEntry]] = [[] for _ in range(impostor.sectors)]
    for layer in impostor.layers:
        sectors[layer.sector].append(_layer_entry(layer, place, camera))
    nodes = tuple(_node(layer, image=i if pictures else None) for i, layer in enumerate(impostor.layers))
    images = tuple(_image(layer, quality) for layer in impostor.layers) if pictures else ()
    gltf = glb_bytes(GlbContents(nodes, images, {"cell": cell.id, "eye": cell.reference.tolist()}))
    glb, exr = folder.write(f"cells/{cell.id}.glb", gltf), None
    if impostor.layers and pictures:
        parts = [_part(layer, place) for layer in impostor.layers]
        exr = folder.write_with(f"cells/{cell.id}.exr", lambda path: _write_exr(path, parts))
    else:
        folder.remove(f"cells/{cell.id}.exr")
    triangles = sum(len(layer.mesh.triangles) for layer in impostor.layers)
    texels = sum(layer.texture.depth.size for layer in impostor.layers)
    size = glb.bytes + (0 if exr is None else exr.bytes)
    near, visible = impostor.near_triangles, impostor.visible_triangles
    draws = (near > 0) + (triangles > 0)
    loads = FrameLoad(near + triangles, draws, texels, size), FrameLoad(visible, int(visible > 0))
    return CellEntry(
        id=cell.id,
        street=cell.street,
        axis=(cell.p, cell.q),
        half_width=cell.half_width,
        eye=cell.eye,
        rise=cell.rise,
        reference=tuple(cell.reference.tolist()),
        neighbours=tuple(neighbours),
        near=tuple(ids[i] for i in impostor.near),
        far=tuple(ids[i] for i in impostor.far),
        layers=tuple(map(tuple, sectors)),
        triangles=triangles,
        near_triangles=near,
        texels=texels,
        bytes=size,
        frame=FrameEntry(*(LoadEntry(**asdict(load), cost=load.cost(costs)) for load in loads)),
        promised_error_px=promise.error_px,
        promise_withheld=promise.withheld,
        largest_weight_px=promise.largest_weight_px,
        missed_px=promise.missed_px,
        displacement_px=promise.displacement_px,
        files=CellFiles(glb, exr),
    )


def read_pictures(dataset: Dataset, cell: str) -> tuple[LayerPicture, ...]:
    """All that it takes to draw a cell's layers, in the manifest's order, from its glTF alone.

    Raises DatasetError when there is no such cell, the dataset holds no pictures, or its file is missing, damaged or not what
    the manifest describes.
    """
    entry = dataset.cell(cell)
    _expect_pictures(dataset)
    if not entry.pictures:
        return ()
    with _layer_nodes(dataset, entry) as (nodes, images):
        return tuple(_picture(entry, sector, one, nodes[one.name], images) for sector, one in entry.pictures)


def read_meshes(dataset: Dataset, cell: str) -> tuple[LayerMesh, ...]:
    """The meshes of a cell's layers and the views of their pictures, in the manifest's order, from its glTF: of any dataset.

    Raises DatasetError when there is no such cell, or its file is missing, damaged or not what the manifest describes.
    """
    entry = dataset.cell(cell)
    if not entry.pictures:
        return ()
    with _layer_nodes(dataset, entry) as (nodes, _):
        return tuple(_mesh(entry, sector, one, nodes[one.name]) for sector, one in entry.pictures)


def read_depths(dataset: Dataset, cell: str) -> dict[str, tuple[NDArray[np.float32], NDArray[np.uint32]]]:
    """What a cell's layers were captured as, from its EXR: name of the layer -> depth and places.

    Depth (h, w) is eye-space metres, ``inf`` where nothing was hit; places (h, w) are 0 there, elsewhere the place of the
    object in the cell's lists ``far`` and then ``near``, from 1.
    Raises DatasetError when there is no such cell, the dataset holds no pictures, or its file is missing, damaged or not what
    the manifest describes.
    """
    entry = dataset.cell(cell)
    _expect_pictures(dataset)
    if entry.files.exr is None:
        return {}
    name = str(dataset.path / entry.files.exr.name)
    data = dataset.read(entry.files.exr)
    found, objects = {}, len(entry.far) + len(entry.near)
    with _as_described(name):
        _check_windows(data, [one for _, one in entry.pictures])
        parts = {part.name(): part.channels for part in OpenEXR.File(io.BytesIO(data)).parts}
        for _, one in entry.pictures:
            channels, shape = parts[one.name], (one.window[3], one.window[2])
            depth, places = channels["Z"].pixels.astype(np.float32), np.array(channels["id"].pixels)
            if depth.shape != shape or places.shape != shape or places.max() > objects:
                raise ValueError(f"{one.name}: depths and places of {objects} objects, {shape}, expected")
            found[one.name] = depth, places
    return found


def _check_windows(data: bytes, layers: Sequence[LayerEntry]) -> None:
    """Raise ValueError unless the parts of an EXR, which is not unpacked yet, are as large as the manifest says."""
    windows = {one.name: one.window for one in layers}
    parts = OpenEXR.File(io.BytesIO(data), header_only=True).parts
    if len(parts) != len(windows):
        raise ValueError(f"{len(windows)} parts expected, found {len(parts)}")
    for part in parts:
        low, high = (np.asarray(corner).tolist() for corner in part.header["dataWindow"])
        left, top, width, height = windows[part.name()]
        if [*low, *high] != [left, top, left + width - 1, top + height - 1]:
            raise ValueError(f"{part.name()}: a window of {width} x {height} expected, found {low} to {high}")


def read_impostor(dataset: Dataset, cell: str, city: City) -> Impostor:
    """A cell's impostor, as it was captured.

    Raises DatasetError when the dataset holds no pictures, or a file is missing, damaged or not what it should be.
    """
    entry = dataset.cell(cell)
    pictures, depths = read_pictures(dataset, cell), read_depths(dataset, cell)
    index, camera = city.index(), dataset.manifest.parameters.camera
    with _as_described(str(dataset.path / "manifest.json")):
        near = np.array([index[one] for one in entry.near], dtype=np.int64)
        far = np.array([index[one] for one in entry.far], dtype=np.int64)
        objects = np.concatenate([[-1], far, near]).astype(np.int32)
        layers = []
        for picture, (_, one) in zip(pictures, entry.pictures, strict=True):
            depth, places = depths[picture.name]
            color = np.ascontiguousarray(picture.pixels[..., :3])
            layers.append(
                Layer(
                    index=picture.index,
                    sector=picture.sector,
                    piece=picture.piece,
                    objects=far[list(one.objects)],
                    texture=DepthTexture(picture.view, color, depth, objects[places]),
                    mesh=picture.mesh,
                    displacement=camera.angle_from_pixels(one.displacement_px),
                    in_order=picture.in_order,
                )
            )
    return Impostor(
        cell=entry.viewing_cell,
        near=near,
        far=far,
        layers=tuple(layers),
        sectors=len(entry.layers),
        near_triangles=entry.near_triangles,
        visible_triangles=entry.frame.geometry.triangles,
        promise=Promise(
            error_px=entry.promised_error_px,
            withheld=entry.promise_withheld,
            largest_weight_px=entry.largest_weight_px,
            missed_px=entry.missed_px,
            displacement_px=entry.displacement_px,
        ),
    )


def _expect_pictures(dataset: Dataset) -> None:
    """Raises DatasetError where the dataset has none."""
    if dataset.manifest.parameters.pictures == "none":
        raise DatasetError(
            f"{dataset.path}: a dataset with pictures of its layers expected, found one built with --pictures none, which has "
            "meshes alone; build it with --pictures all"
        )


@contextmanager
def _layer_nodes(dataset: Dataset, entry: CellEntry) -> Iterator[tuple[dict[str, GlbNode], Sequence[GlbImage]]]:
    """The nodes of a cell's glTF by name, and its images, while they are held against the manifest."""
    name = str(dataset.path / entry.files.glb.name)
    contents = read_glb(dataset.read(entry.files.glb), name=name)
    with _as_described(name):
        yield {node.name: node for node in contents.nodes}, contents.images


@contextmanager
def _as_described(name: str) -> Iterator[None]:
    """Turns what goes wrong while a file's contents are held against the manifest into a DatasetError."""
    try:
        yield
    except (
        KeyError,
        ValueError,
        IndexError,
        TypeError,
        RuntimeError,
        OSError,
        ParameterError,
        Image.DecompressionBombError,
    ) as error:
        raise DatasetError(
            f"{name}: the layers that the manifest describes expected, found others ({error!r})"
        ) from error


def _picture(entry: CellEntry, sector: int, one: LayerEntry, node: GlbNode, images: Sequence[GlbImage]) -> LayerPicture:
    """The inverse of :func:`_node` and :func:`_image`. Raises ValueError where node and manifest do not agree."""
    found = _mesh(entry, sector, one, node)
    image = node.primitives[0].image
    if image is None:
        raise ValueError(f"{node.name}: a texture expected")
    with Image.open(io.BytesIO(images[image].data), formats=("WEBP",)) as picture:
        if picture.size != one.window[2:]:
            raise ValueError(f"{node.name}: a picture of {one.window[2:]} expected, found one of {picture.size}")
        pixels = np.array(picture)
    return LayerPicture(one.name, one.index, sector, one.piece, found.view, pixels, found.mesh, one.in_order)


def _mesh(entry: CellEntry, sector: int, one: LayerEntry, node: GlbNode) -> LayerMesh:
    """The inverse of :func:`_node`. Raises ValueError where node and manifest do not agree."""
    view = entry.view(sector, one)
    extras = _extras(one.index, sector, one.piece, view)
    if node.extras != extras:
        raise ValueError(f"{node.name}: {extras} expected, found {node.extras}")
    (primitive,) = node.primitives
    if primitive.uv is None or len(primitive.triangles) != one.triangles:
        raise ValueError(f"{node.name}: texture coordinates and {one.triangles} triangles expected")
    mesh = GridMesh(primitive.positions, primitive.uv, primitive.triangles)
    return LayerMesh(one.name, one.index, sector, one.piece, view, mesh, one.in_order)


def _layer_entry(layer: Layer, place: NDArray[np.uint32], camera: Camera) -> LayerEntry:
    depths = layer.texture.view.project(layer.mesh.vertices.astype(np.float64))[:, 2]
    return LayerEntry(
        name=layer.name,
        index=layer.index,
        piece=layer.piece,
        objects=tuple(int(place[i]) - 1 for i in layer.objects),
        focal=layer.texture.view.focal,
        window=layer.texture.view.window,
        triangles=len(layer.mesh.triangles),
        in_order=layer.in_order,
        depth=(float(depths.min()), float(depths.max())),
        displacement_px=camera.pixels_from_angle(layer.displacement),
    )


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
    try:
        OpenEXR.File(parts).write(str(path))
    except ValueError as error:  # a path that is no UTF-8
        raise RuntimeError("OpenEXR takes paths of UTF-8 only") from error


def _image(layer: Layer, quality: int) -> GlbImage:
    """Colour, dilated beyond the silhouette, and coverage as alpha."""
    pixels = np.empty((*layer.texture.depth.shape, 4), dtype=np.uint8)
    pixels[..., :3] = layer.texture.color
    pixels[..., 3] = np.where(layer.texture.coverage, 255, 0)
    buffer = io.BytesIO()
    options = {"lossless": True, "quality": 0} if quality == 100 else {"quality": quality}
    Image.fromarray(pixels).save(buffer, "WEBP", method=2, exact=True, **options)
    return GlbImage(buffer.getvalue())


def _node(layer: Layer, *, image: int | None) -> GlbNode:
    """A layer's mesh, and how its texture was captured."""
    mesh = layer.mesh
    primitive = GlbPrimitive(mesh.vertices, mesh.triangles, uv=mesh.uv, image=image, masked=True)
    return GlbNode(layer.name, (primitive,), _extras(layer.index, layer.sector, layer.piece, layer.texture.view))


def _extras(index: int, sector: int, piece: int, view: View) -> dict[str, Any]:
    """What the glTF says of a layer's picture, besides what is drawn."""
    return {"sector": sector, "layer": index, "piece": piece, "focal": view.focal, "window": list(view.window)}
