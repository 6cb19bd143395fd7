"""glTF 2.0 (.glb, .gltf) as users have it: any valid file's nodes, materials and pictures become meshes of a city, Z up.

``mmi.dataset.glb`` reads what this project's datasets hold; this reads what others write, and cities that
``mmi.writing.gltf_writer`` wrote (a material "painted", a node "terrain", streets as lines, ``asset.extras`` with CRS and
origin). ``mmi.reading.models.gltf_buffers`` opens the file and gets the arrays behind accessors.

Source: Khronos, glTF 2.0 specification; the extensions KHR_texture_transform, KHR_mesh_quantization, EXT_texture_webp,
EXT_mesh_gpu_instancing.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
from numpy.typing import NDArray
from shapely.geometry import LineString

from mmi import limits
from mmi.city.model import PAINTED, PLAIN, TriangleMesh
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.srgb import srgb_from_linear
from mmi.gltf.codes import (
    LINE_LOOP,
    LINE_STRIP,
    LINES,
    REPEAT,
    TRIANGLE_FAN,
    TRIANGLE_STRIP,
    TRIANGLES,
    WEBP,
)
from mmi.reading.coordinates import parse_crs
from mmi.reading.models.gltf_buffers import GltfFile, open_gltf
from mmi.reading.models.raw_meshes import joined_meshes, placed_corners
from mmi.reading.pictures import PictureShelf
from mmi.reading.raw_layers import ModelLayer, RawModel, RawStreet
from mmi.reading.report import Ledger

__all__ = ["read_gltf"]

_Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_PLUMB = 1e-3
"""Metres: a segment goes straight up if it goes less to the side and over a hundred times as much up."""
_DAMAGE = (LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, binascii.Error)
"""What Python raises on glTF of another shape than expected."""
_INSTANCING = "EXT_mesh_gpu_instancing"
_READ_EXTENSIONS = frozenset(
    {"KHR_texture_transform", "KHR_mesh_quantization", WEBP, _INSTANCING, "KHR_lights_punctual", "KHR_xmp_json_ld"}
)


@dataclass(frozen=True, slots=True)
class _Look:
    """A material: place of its texture (or PLAIN, PAINTED), linear factor, and how its texture coordinates are found."""

    texture: int
    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    attribute: str = "TEXCOORD_0"
    transform: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 1.0, 1.0)


def read_gltf(path: Path, ledger: Ledger) -> ModelLayer:
    """All nodes with triangles or lines, transforms applied, Z up; ids are the nodes' names (they may repeat).

    Raises:
        CityError: not glTF 2.0, damaged, compressed in a way that is not read, or with files outside its folder.
    """
    try:
        gltf = open_gltf(path, ledger)
        _refuse_extensions(path, gltf.document)
        with np.errstate(all="ignore"):  # what becomes infinite is dropped, and counted
            return _Reading(path, gltf, ledger).layer()
    except CityError as error:
        if str(path) in str(error):
            raise
        raise CityError(f"{path}: {error}") from error
    except _DAMAGE as error:
        what = f"no {error} where one is needed" if isinstance(error, KeyError) else str(error)
        raise CityError(f"{path}: expected glTF 2.0, complete and valid; found: {what}") from error


def _refuse_extensions(path: Path, document: dict[str, Any]) -> None:
    needed = [str(one) for one in document.get("extensionsRequired", [])]
    strange = [one for one in needed if one not in _READ_EXTENSIONS and not one.startswith("KHR_materials_")]
    if strange:
        raise CityError(
            f"{path}: needs the glTF extension {', '.join(strange)}, which is not read; expected a plain file, as written by "
            "`gltf-transform copy IN.glb OUT.glb` (npm @gltf-transform/cli) or exported by Blender without compression"
        )


class _Reading:
    """One file while it is read."""

    def __init__(self, path: Path, gltf: GltfFile, ledger: Ledger) -> None:
        self.path, self.gltf, self.ledger = path, gltf, ledger
        self.shelf = PictureShelf(ledger)
        self.looks: dict[int, _Look] = {}
        self.models: list[RawModel] = []
        self.streets: list[RawStreet] = []
        self.ground: list[TriangleMesh] = []
        self.corners = 0

    def layer(self) -> ModelLayer:
        extras = self.gltf.document.get("asset", {}).get("extras")
        extras = extras if isinstance(extras, dict) else {}
        origin = np.array([*map(float, extras.get("origin", (0.0, 0.0, 0.0)))])
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise CityError(f"asset.extras.origin: three numbers expected, found {extras.get('origin')!r}")
        damage: Exception | None = None
        for node, matrix in self.placed_nodes():
            models, streets, ground = len(self.models), len(self.streets), len(self.ground)
            try:
                self.take(node, matrix, origin)
            except _DAMAGE as error:
                del self.models[models:], self.streets[streets:], self.ground[ground:]
                self.ledger.note(
                    "left out", "mesh: not as glTF describes it", str(node.get("name") or "without a name")
                )
                damage = damage or error
        if damage is not None and not self.models:
            raise damage
        if not self.models and not self.ground and not self.streets:
            why = self.ledger.why_left_out()
            raise CityError(f"{self.path}: no triangles in it; expected a node with a mesh for each building{why}")
        terrain = self.ground[0] if self.ground else None
        if len(self.ground) > 1:
            self.ledger.note("left out", "terrain: a second one", "terrain", count=len(self.ground) - 1)
        return ModelLayer(
            str(self.path),
            tuple(self.models),
            _crs_from_extras(extras.get("crs")),
            self.shelf.textures(),
            terrain,
            tuple(self.streets),
        )

    def placed_nodes(self) -> list[tuple[dict[str, Any], NDArray[np.float64]]]:
        """Nodes with a mesh and their (4, 4) placement in a Z up world, in the scene's order; each copy of a node by itself."""
        document = self.gltf.document
        nodes = document.get("nodes", [])
        if "scenes" in document:
            shown, scenes = int(document.get("scene", 0)), document["scenes"]
            if not 0 <= shown < len(scenes):
                raise ValueError(f"scene {shown} is to be shown, the file has {len(scenes)}")
            roots = scenes[shown].get("nodes", [])
        else:
            children = {int(child) for node in nodes for child in node.get("children", [])}
            roots = [i for i in range(len(nodes)) if i not in children]
        found: list[tuple[dict[str, Any], NDArray[np.float64]]] = []
        seen: set[int] = set()
        stack = [(int(root), _Z_UP_FROM_Y_UP) for root in reversed(roots)]
        while stack:
            index, parent = stack.pop()
            if index in seen or index < 0:
                raise ValueError(f"node {index} hangs from two parents")
            seen.add(index)
            node = nodes[index]
            matrix = parent @ _placement(node)
            if "mesh" in node:
                found += [(node, matrix @ copy) for copy in self.copies(node, _name(node, index))]
            if len(found) > limits.INSTANCES + len(nodes):
                raise ValueError(f"over {limits.INSTANCES} instances of meshes")
            stack += [(int(child), matrix) for child in reversed(node.get("children", []))]
        for index, node in enumerate(nodes):
            if "mesh" in node and index not in seen:
                self.ledger.note("left out", "mesh: not in the scene that is shown", _name(node, index))
        return found

    def copies(self, node: dict[str, Any], name: str) -> list[NDArray[np.float64]]:
        """node_from_instance (4, 4) of each copy of a node's mesh that EXT_mesh_gpu_instancing asks for; of others, one."""
        entry = node.get("extensions", {}).get(_INSTANCING)
        if entry is None:
            return [np.eye(4)]
        keys = {"TRANSLATION": "translation", "ROTATION": "rotation", "SCALE": "scale"}
        columns = {keys[key]: self.gltf.accessor(index) for key, index in entry["attributes"].items() if key in keys}
        counts = {len(values) for values in columns.values()}
        if len(counts) != 1 or max(counts) > limits.INSTANCES:
            raise ValueError(
                f"node {name}: instances expected, as many of each kind of attribute, found {sorted(counts)}"
            )
        self.ledger.note("read", f"instances of meshes ({_INSTANCING})", name, count=max(counts))
        return [_placement({key: values[i].tolist() for key, values in columns.items()}) for i in range(max(counts))]

    def take(self, node: dict[str, Any], matrix: NDArray[np.float64], origin: NDArray[np.float64]) -> None:
        """A node becomes a model, the terrain or streets; lines that draw the edges of a model are none of them.

        A node whose extras say its ``kind`` is a street whatever its lines look like.
        """
        entry = self.gltf.document["meshes"][int(node["mesh"])]
        name = str(node.get("name") or entry.get("name") or f"mesh/{node['mesh']}")
        parts: list[TriangleMesh] = []
        lines: list[LineString] = []
        upright = False
        for primitive in entry["primitives"]:
            mode = primitive.get("mode", TRIANGLES)
            if "POSITION" not in primitive["attributes"]:
                self.ledger.note("left out", "mesh: no positions", name)
                continue
            points = self.gltf.accessor(primitive["attributes"]["POSITION"])[:, :3]
            points = points @ matrix[:3, :3].T + matrix[:3, 3] + origin
            order = (
                self.gltf.accessor(primitive["indices"], integer=True).reshape(-1)
                if "indices" in primitive
                else np.arange(len(points))
            )
            self.corners += max(len(order), len(points))
            if self.corners > 3 * limits.PLACED_TRIANGLES:
                raise CityError(
                    f"at most {limits.PLACED_TRIANGLES} triangles expected, found more, meshes as often as used"
                )
            if order.size and not 0 <= order.min() <= order.max() < len(points):
                raise ValueError(f"node {name}: indices below {len(points)} expected, found up to {order.max()}")
            if mode in (TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN):
                parts.append(self.triangles(primitive, points, _as_triangles(order, mode), matrix, name))
            elif mode in (LINES, LINE_LOOP, LINE_STRIP):
                lines += _as_lines(points[order], mode)
                upright |= _stands_upright(points[order], mode)
            else:
                self.ledger.note("left out", "mesh: points", name)
        if node.get("skin") is not None or any("targets" in one for one in entry["primitives"]):
            self.ledger.note("noted", "animated mesh taken at rest", name)
        parts = [part for part in parts if len(part.triangles)]
        if parts and name.lower() == "terrain":
            self.ground.append(joined_meshes(parts))
        elif parts:
            self.models.append(RawModel(name, joined_meshes(parts)))
        extras = node.get("extras")
        is_street = isinstance(extras, dict) and bool(extras.get("kind"))
        if lines and (parts or upright) and not is_street:
            self.ledger.note("noted", "lines that draw the edges of a model: no streets", name)
        elif lines:
            self.streets.append(_street(name, extras, lines))

    def triangles(
        self,
        primitive: dict[str, Any],
        points: NDArray[np.float64],
        triangles: NDArray[np.int64],
        matrix: NDArray[np.float64],
        name: str,
    ) -> TriangleMesh:
        """A primitive with its looks; triangles with corners that have no place are dropped."""
        points, keep = placed_corners(points, triangles, name, self.ledger)
        triangles = triangles[keep]
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            triangles = triangles[:, ::-1]
        m = len(triangles)
        attributes = primitive["attributes"]
        look = self.look(primitive["material"]) if "material" in primitive else _Look(PAINTED)
        texture, linear = look.texture, np.tile(look.factor, (m, 1))
        if "COLOR_0" in attributes and (texture != PAINTED or "material" not in primitive):
            own = np.clip(self.gltf.accessor(attributes["COLOR_0"])[:, :3], 0.0, 1.0)
            linear = linear * own[triangles].mean(axis=1)
            texture = PLAIN if texture == PAINTED else texture
        uv = None
        if texture >= 0:
            if look.attribute in attributes:
                flat = _transformed(self.gltf.accessor(attributes[look.attribute])[:, :2], look.transform)
                uv = np.nan_to_num(flat, posinf=0.0, neginf=0.0)[triangles]
            else:
                self.ledger.note("noted", "texture without coordinates: its colour only", name)
                texture = PLAIN
        colors = None if texture == PAINTED else srgb_from_linear(np.clip(linear, 0.0, 1.0))
        return TriangleMesh(points, triangles, np.full(m, texture), colors, uv)  # type: ignore[arg-type]

    def look(self, index: int) -> _Look:
        if index not in self.looks:
            self.looks[index] = self._look(self.gltf.document["materials"][int(index)], f"material {index}")
        return self.looks[index]

    def _look(self, material: dict[str, Any], where: str) -> _Look:
        name = str(material.get("name") or where)
        if name == "painted":
            return _Look(PAINTED)
        gloss = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        surface = material.get("pbrMetallicRoughness", {})
        info, factor = surface.get("baseColorTexture"), surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))
        if gloss is not None:
            info, factor = gloss.get("diffuseTexture", info), gloss.get("diffuseFactor", factor)
        red, green, blue, opacity = (min(max(float(one), 0.0), 1.0) for one in factor)
        mode = material.get("alphaMode", "OPAQUE")
        if mode == "BLEND" and opacity < 1.0:
            self.ledger.note("noted", "transparent material drawn opaque", name)
        place = None if info is None else self.texture(int(info["index"]), alpha=mode != "OPAQUE")
        if info is None or place is None:
            return _Look(PLAIN, (red, green, blue))
        moved = info.get("extensions", {}).get("KHR_texture_transform", {})
        (du, dv), (su, sv) = moved.get("offset", (0.0, 0.0)), moved.get("scale", (1.0, 1.0))
        transform = (float(du), float(dv), float(moved.get("rotation", 0.0)), float(su), float(sv))
        attribute = f"TEXCOORD_{int(moved.get('texCoord', info.get('texCoord', 0)))}"
        return _Look(place, (red, green, blue), attribute, transform)

    def texture(self, index: int, *, alpha: bool) -> int | None:
        """Place of the texture's picture; None, and a note, where it has none that can be read."""
        document = self.gltf.document
        entry = document["textures"][index]
        source = entry.get("source", entry.get("extensions", {}).get(WEBP, {}).get("source"))
        if source is None:
            self.ledger.note("left out", "picture: in a format that is not read (KTX2 or none)", f"texture {index}")
            return None
        sampler = document["samplers"][int(entry["sampler"])] if "sampler" in entry else {}
        image = document["images"][int(source)]
        name = Path(str(image.get("uri", ""))).name if not str(image.get("uri", "data:")).startswith("data:") else ""
        name = str(image.get("name") or name or f"image {source}")
        if {sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)} != {REPEAT}:
            self.ledger.note("noted", "picture that clamps or mirrors at its edges: repeated instead", name)
        data = self.gltf.image(int(source))
        return None if data is None else self.shelf.place(data, name, alpha=alpha)


def _name(node: dict[str, Any], index: int) -> str:
    return str(node.get("name") or f"node {index}")


def _placement(node: dict[str, Any]) -> NDArray[np.float64]:
    """parent_from_node (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = (float(one) for one in node.get("rotation", (0.0, 0.0, 0.0, 1.0)))
    matrix = np.eye(4)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix


def _as_triangles(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Corners (m, 3) of a list, strip or fan."""
    if mode == TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    n = max(len(order) - 2, 0)
    if mode == TRIANGLE_FAN:
        return np.column_stack([np.full(n, order[0] if len(order) else 0), order[1 : n + 1], order[2 : n + 2]])
    flip = np.arange(n) % 2
    k = np.arange(n)
    return np.column_stack([order[k], order[k + 1 + flip], order[k + 2 - flip]]) if n else np.empty((0, 3), np.int64)


def _as_lines(points: NDArray[np.float64], mode: int) -> list[LineString]:
    """Lines in plan; a list of segments that follow one another is one line."""
    points = points[:, :2]
    if mode == LINE_LOOP:
        points = np.concatenate([points, points[:1]])
    if mode == LINES:
        pairs = points[: len(points) // 2 * 2].reshape(-1, 2, 2)
        breaks = np.flatnonzero((pairs[1:, 0] != pairs[:-1, 1]).any(axis=1)) + 1
        runs = [np.concatenate([run[:1, 0], run[:, 1]]) for run in np.split(pairs, breaks) if len(run)]
    else:
        runs = [points]
    lines = [LineString(run) for run in runs if len(run) > 1 and np.isfinite(run).all()]
    return [line for line in lines if line.length > 0.0]


def _stands_upright(points: NDArray[np.float64], mode: int) -> bool:
    """Whether a segment of the lines goes straight up, as edges of buildings do and streets never."""
    starts, ends = (points[0:-1:2], points[1::2]) if mode == LINES else (points[:-1], points[1:])
    run = (ends - starts)[:, :3]
    return bool(((np.hypot(run[:, 0], run[:, 1]) < _PLUMB) & (np.abs(run[:, 2]) > 100.0 * _PLUMB)).any())


def _street(name: str, extras: object, lines: list[LineString]) -> RawStreet:
    """Lines as a street; the node's extras ``kind``, ``width`` and ``name`` are its tags."""
    said = extras if isinstance(extras, dict) else {}
    tags = {
        tag: str(said[key]) for key, tag in (("kind", "highway"), ("width", "width"), ("name", "name")) if said.get(key)
    }
    return RawStreet(name, tuple(lines), {"highway": "road"} | tags)


def _transformed(uv: NDArray[np.float64], transform: tuple[float, float, float, float, float]) -> NDArray[np.float64]:
    """Texture coordinates after KHR_texture_transform (scale, turn, shift, all with v down), with v up."""
    du, dv, angle, su, sv = transform
    c, s = np.cos(angle), np.sin(angle)
    u, v = uv[:, 0] * su, uv[:, 1] * sv
    return np.column_stack([du + c * u + s * v, 1.0 - (dv - s * u + c * v)])


def _crs_from_extras(text: object) -> pyproj.CRS | None:
    """The horizontal CRS that ``asset.extras.crs`` names."""
    if not isinstance(text, str) or text in ("", "local"):
        return None
    try:
        return parse_crs(text)
    except ParameterError as error:
        raise CityError(f"asset.extras.crs: a CRS expected, found {text[:80]!r}") from error
