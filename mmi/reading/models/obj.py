"""Wavefront OBJ with its .mtl: objects or groups become meshes, in the file's own axes.

Where ``o`` names several objects those are the buildings, else the groups of ``g``; a name that comes back continues its
mesh. Texture coordinates run up as they do in a city. ``Kd`` is taken as sRGB, and not multiplied into a picture: what
exporters write beside ``map_Kd`` is black or grey more often than meant. Only faces are read.

The format does not say how names are encoded: they are compared as bytes, and lines and words are split at ASCII characters
only (in Shift-JIS and GBK the second byte of a character may be a backslash).

Source: Wavefront, Advanced Visualizer Manual, appendix B (object files) and the .mtl format.
"""

from __future__ import annotations

import math
import os
import re
from codecs import BOM_UTF8
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mmi import limits
from mmi.city.model import PAINTED, PLAIN, TriangleMesh
from mmi.foundation.errors import CityError
from mmi.foundation.whole_files import bytes_within
from mmi.reading.models.raw_meshes import cut_polygons, number_of, placed_corners
from mmi.reading.names import readable_name
from mmi.reading.pictures import PictureShelf, contained_path, file_beside
from mmi.reading.raw_layers import ModelLayer, RawModel
from mmi.reading.report import Ledger

__all__ = ["read_obj"]

_NOTHING = -1
_ENDLESS = 1 << 40
"""No file has so many points."""
# Options of a map in a .mtl -> the most arguments that they take.
_MAP_OPTIONS = (
    (b"-blendu", 1), (b"-blendv", 1), (b"-bm", 1), (b"-boost", 1), (b"-cc", 1), (b"-clamp", 1), (b"-imfchan", 1), (b"-mm", 2),
    (b"-o", 3), (b"-s", 3), (b"-t", 3), (b"-texres", 1), (b"-type", 1),
)  # fmt: skip
# A backslash at the end of a line continues it, unless it ends a character of two bytes.
_CONTINUED = re.compile(rb"(?<![\x80-\xff])\\\r?\n")


@dataclass(frozen=True, slots=True)
class _Look:
    """A material: place of its picture or PLAIN or PAINTED, sRGB colour, and texture coordinates' scale and shift."""

    texture: int
    color: tuple[int, int, int] = (255, 255, 255)
    scale: tuple[float, float] = (1.0, 1.0)
    shift: tuple[float, float] = (0.0, 0.0)


@dataclass(slots=True)
class _Faces:
    """Polygons of a file: corner counts, and per corner places of point and texture coordinate; per face its names."""

    sizes: list[int] = field(default_factory=list)
    points: list[int] = field(default_factory=list)
    places: list[int] = field(default_factory=list)
    objects: list[bytes] = field(default_factory=list)
    groups: list[bytes] = field(default_factory=list)
    materials: list[bytes] = field(default_factory=list)


def read_obj(path: Path, ledger: Ledger) -> ModelLayer:
    """Objects or groups of ``path``, names as ids, in the axes of the file.

    Raises:
        CityError: no faces, more lines that cannot be or corners that do not exist than sound ones, or files outside its
            folder.
    """
    points, colors, coordinates, faces, libraries = _read_lines(path, ledger)
    if colors is not None and _are_bytes(colors):
        ledger.note("noted", "colours of vertices from 0 to 255 instead of 0 to 1", path.name)
        colors = colors / 255.0
    if not faces.sizes:
        raise CityError(
            f"{path}: expected OBJ with faces (lines that start with f), found {len(points)} points and no face"
        )
    shelf = PictureShelf(ledger)
    looks: dict[bytes, _Look] = {}
    for line in libraries:
        for name in _library_names(path, line):
            looks |= _read_materials(path, name, shelf, ledger)
    triangles, face_of = cut_polygons(points, np.array(faces.sizes), np.array(faces.points))
    mesh = _dressed(path, points, colors, coordinates, faces, triangles, face_of, looks, ledger)
    names = faces.objects if len(set(faces.objects)) > 1 or not any(faces.groups) else faces.groups
    first: dict[bytes, int] = {}
    for name in names:
        first.setdefault(name, len(first))
    group_of = np.array([first[name] for name in names])[face_of]
    order = np.argsort(group_of, kind="stable")
    shares = np.split(order, np.cumsum(np.bincount(group_of, minlength=len(first)))[:-1])
    items = []
    for name, mine in zip(first, shares, strict=True):
        id_ = readable_name(name) or path.stem
        one = mesh(mine, id_)
        if one is not None:
            items.append(RawModel(id_, one))
    if not items:
        raise CityError(f"{path}: expected faces with corners that are numbers, found none")
    return ModelLayer(str(path), tuple(items), None, shelf.textures())


def _read_lines(
    path: Path, ledger: Ledger
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.float64], _Faces, list[bytes]]:
    """Points (n, 3), their colours (n, 3) as they stand there or None, texture coordinates (k, 2), faces, and .mtl names."""
    points: list[tuple[float, ...]] = []
    tints: list[tuple[float, ...]] = []
    coordinates: list[tuple[float, float]] = []
    faces = _Faces()
    libraries: list[bytes] = []
    owner = group = material = b""
    damage: CityError | None = None
    damages = 0
    text = _CONTINUED.sub(b" ", path.read_bytes().removeprefix(BOM_UTF8))
    if b"\0" in text:
        raise CityError(f"{path}: expected OBJ, which is text; found binary data")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        key = words[0]
        try:
            if key == b"v":
                x, y, z, *tint = map(number_of, words[1:7] if len(words) >= 7 else words[1:4])
                points.append((x, y, z))
                tints += [tuple(tint)] if tint else []
            elif key == b"f":
                if len(words) < 4:
                    continue  # a line or a point
                parts = [word.split(b"/") for word in words[1:]]
                corners = [_place(int(part[0]), len(points)) for part in parts]
                places = [
                    _place(int(part[1]), len(coordinates)) if part[1:] and part[1] else _NOTHING for part in parts
                ]
                faces.points += corners
                faces.places += places
                faces.sizes.append(len(words) - 1)
                faces.objects.append(owner)
                faces.groups.append(group)
                faces.materials.append(material)
            elif key == b"vt":
                coordinates.append((number_of(words[1]), number_of(words[2]) if len(words) > 2 else 0.0))
            elif key == b"o":
                owner = b" ".join(words[1:])
            elif key == b"g":
                group = b" ".join(words[1:])
            elif key == b"usemtl":
                material = line.split(None, 1)[1].strip() if len(words) > 1 else b""
            elif key == b"mtllib":
                libraries.append(line.split(None, 1)[1].strip())
        except (ValueError, IndexError) as error:
            found = readable_name(line.strip()[:60])
            damage = damage or CityError(f"{path}: line {number}: expected OBJ, found {found!r} ({error})")
            damages += 1
            ledger.note("left out", "line: no OBJ", f"line {number}")
            if key == b"v":  # what follows is counted from it
                points.append((np.nan,) * 3)
                tints += [(np.nan,) * 3] if tints else []
            elif key == b"vt":
                coordinates.append((np.nan, np.nan))
    if damage is not None and damages >= len(faces.sizes):
        raise damage
    xyz = np.array(points, dtype=np.float64).reshape(-1, 3)
    tints_of_all = np.array(tints, dtype=np.float64) if points and len(tints) == len(points) else None
    faces = _with_corners(path, faces, len(xyz), "points", ledger)
    faces = _with_corners(path, faces, len(coordinates), "texture coordinates", ledger)
    return xyz, tints_of_all, np.array(coordinates, dtype=np.float64).reshape(-1, 2), faces, libraries


def _are_bytes(colors: NDArray[np.float64]) -> bool:
    """Whether colours (n, 3) are whole numbers up to 255, some above 1, as programs write that have bytes."""
    finite = colors[np.isfinite(colors)]
    return bool(finite.size) and 1.0 < finite.max() <= 255.0 and bool((finite == np.rint(finite)).all())


def _place(index: int, count: int) -> int:
    """From OBJ's 1, 2, ... and -1 (the last so far), -2, ... to 0, 1, ..."""
    if index == 0 or not -count <= index < _ENDLESS:
        raise ValueError(f"no element {index} among {count}")
    return index - 1 if index > 0 else count + index


def _with_corners(path: Path, faces: _Faces, count: int, what: str, ledger: Ledger) -> _Faces:
    """The faces whose corners are among the ``count`` points or texture coordinates of the file; the others are counted.

    Raises:
        CityError: so many are not that the file is cut off.
    """
    places = np.array(faces.points if what == "points" else faces.places, dtype=np.int64)
    if not places.size or places.max() < count:
        return faces
    sizes = np.array(faces.sizes)
    starts = np.cumsum(sizes) - sizes
    sound = np.logical_and.reduceat(places < count, starts)
    if 2 * sound.sum() <= len(sound):
        raise CityError(f"{path}: a face needs {what} number {places.max() + 1}, the file has {count}: is it cut off?")
    ledger.note("left out", f"face: {what} that are not in the file", path.name, count=int((~sound).sum()))
    kept = np.flatnonzero(sound).tolist()
    corners = np.flatnonzero(np.repeat(sound, sizes)).tolist()
    return _Faces(
        [faces.sizes[i] for i in kept],
        [faces.points[i] for i in corners],
        [faces.places[i] for i in corners],
        [faces.objects[i] for i in kept],
        [faces.groups[i] for i in kept],
        [faces.materials[i] for i in kept],
    )


def _library_names(path: Path, line: bytes) -> list[bytes]:
    """The names after ``mtllib``: files may be listed there, and a file's name may have spaces, so what exists decides."""
    words = line.split()
    if len(words) < 2 or _is_there(line, path):
        return [line]
    names: list[bytes] = []
    missing: list[bytes] = []
    while words:
        runs = (b" ".join(words[:n]) for n in range(len(words), 0, -1))
        found = next((run for run in runs if _is_there(run, path)), None)
        if found is None:
            missing.append(words.pop(0))
        else:
            names.append(found)
            words = words[found.count(b" ") + 1 :]
    return names + ([b" ".join(missing)] if missing else [])


def _read_materials(path: Path, name: bytes, shelf: PictureShelf, ledger: Ledger) -> dict[bytes, _Look]:
    """The materials of a .mtl beside ``path``; none, and a note, where it is missing."""
    file = _found(name, path, ledger) or contained_path(path.parent, _as_text(name), path)
    if not file.is_file():
        ledger.note("left out", "materials: their .mtl is missing", readable_name(name))
        return {}
    looks: dict[bytes, _Look] = {}
    tints: dict[bytes, tuple[float, float, float]] = {}
    current = b""
    for number, line in enumerate(
        bytes_within(file, limits.SMALL_BYTES, CityError).removeprefix(BOM_UTF8).splitlines(), 1
    ):
        words = line.split()
        if not words:
            continue
        key = words[0].lower()
        try:
            if key == b"newmtl":
                current = line.split(None, 1)[1].strip()
                looks[current] = _Look(PAINTED if current == b"painted" else PLAIN)
                tints.pop(current, None)
            elif current and key == b"kd" and looks[current].texture == PLAIN:
                kd = [float(word) for word in words[1:4]]
                red, green, blue = (kd * 3)[: max(3, len(kd))]
                if math.isnan(red + green + blue):
                    raise ValueError("no number")
                tints[current] = (red, green, blue)
            elif current and key == b"map_kd":
                looks[current] = _mapped(file, words[1:], shelf, ledger) or looks[current]
            elif (key == b"d" and float(words[-1]) < 1.0) or (key == b"tr" and float(words[-1]) > 0.0):
                ledger.note("noted", "transparent material drawn opaque", readable_name(current))
        except (ValueError, IndexError) as error:
            found = readable_name(line.strip()[:60])
            raise CityError(f"{file}: line {number}: expected a material, found {found!r} ({error})") from error
    white = 1.0
    if _are_bytes(np.array([*tints.values()])):
        ledger.note("noted", "colours of materials from 0 to 255 instead of 0 to 1", file.name)
        white = 255.0
    for of, tint in tints.items():
        if looks[of].texture == PLAIN:
            red, green, blue = (round(255.0 * min(max(one / white, 0.0), 1.0)) for one in tint)
            looks[of] = _Look(PLAIN, (red, green, blue))
    return looks


def _as_text(name: bytes) -> str:
    """A file's name; bytes that are no UTF-8 stand for themselves."""
    return name.decode("utf-8", errors="surrogateescape")


def _is_there(name: bytes, file: Path) -> bool:
    """Whether there is a file of this very name beside ``file``."""
    with suppress(CityError, OSError, ValueError):
        return contained_path(file.parent, _as_text(name), file).is_file()
    return False


def _found(name: bytes, file: Path, ledger: Ledger) -> Path | None:
    """The file that ``file``, beside it, refers to by ``name``."""
    return file_beside(file.parent, _as_text(name), ledger)


def _mapped(file: Path, words: list[bytes], shelf: PictureShelf, ledger: Ledger) -> _Look | None:
    """The look that ``map_Kd`` gives; None, and a note, where the picture is missing or cannot be read."""
    takes = dict(_MAP_OPTIONS)
    numbers: dict[bytes, list[float]] = {b"-s": [], b"-o": []}
    at = 0
    while at < len(words) - 1 and words[at] in takes:
        option, at = words[at], at + 1
        for taken in range(takes[option]):
            if taken and not _is_number(words[at]):
                break
            if option in numbers:
                numbers[option].append(float(words[at]))
            if option == b"-clamp" and words[at] == b"on":
                what = "picture that clamps or mirrors at its edges: repeated instead"
                ledger.note("noted", what, readable_name(words[-1]))
            at += 1
    name = b" ".join(words[at:])
    picture = _found(name, file, ledger)
    if picture is None:
        ledger.note("left out", "picture: its file is missing", readable_name(name))
        return None
    place = shelf.place_file(picture, readable_name(os.fsencode(picture.name)), alpha=True)
    if place is None:
        return None
    su, sv = [*numbers[b"-s"], 1.0, 1.0][:2]
    du, dv = [*numbers[b"-o"], 0.0, 0.0][:2]
    return _Look(place, (255, 255, 255), (su, sv), (du, dv))


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _dressed(
    path: Path,
    points: NDArray[np.float64],
    tint: NDArray[np.float64] | None,
    coordinates: NDArray[np.float64],
    faces: _Faces,
    triangles: NDArray[np.int64],
    face_of: NDArray[np.int64],
    looks: dict[bytes, _Look],
    ledger: Ledger,
) -> Callable[[NDArray[np.intp], str], TriangleMesh | None]:
    """Makes a mesh of some of the triangles (and a name for the ledger): with looks, without corners that have no place."""
    names = list(dict.fromkeys(faces.materials))
    number = {name: i for i, name in enumerate(names)}
    for name in names:
        if name and name not in looks:
            ledger.note("noted", "material that no .mtl defines: painted", readable_name(name))
    shown = [looks.get(name, _Look(PAINTED)) for name in names]
    look_of = np.array([number[name] for name in faces.materials])[face_of]
    corners, places = np.array(faces.points)[triangles], np.array(faces.places)[triangles]
    textures = np.array([look.texture for look in shown])[look_of]
    colors = np.array([look.color for look in shown], dtype=np.uint8)[look_of]
    bare = (textures >= 0) & (places == _NOTHING).any(axis=1)
    if bare.any():
        ledger.note("noted", "texture without coordinates: its colour only", path.name, count=int(bare.sum()))
        textures[bare] = PLAIN
    if tint is not None:
        mine = textures == PAINTED
        mean = np.clip(np.nan_to_num(tint[corners].mean(axis=1)), 0.0, 1.0)
        colors[mine] = np.rint(255.0 * mean[mine]).astype(np.uint8)
        textures[mine] = PLAIN
    uv = np.zeros((len(triangles), 3, 2))
    covered = textures >= 0
    scale, shift = (np.array([getattr(look, key) for look in shown])[look_of] for key in ("scale", "shift"))
    uv[covered] = coordinates[places[covered]] * scale[covered, None] + shift[covered, None]
    uv = np.nan_to_num(uv, posinf=0.0, neginf=0.0)

    def mesh(mine: NDArray[np.intp], name: str) -> TriangleMesh | None:
        used, own = np.unique(corners[mine], return_inverse=True)
        own = own.reshape(-1, 3)
        placed, keep = placed_corners(points[used], own, name, ledger)
        if not keep.any():
            return None
        mine = mine[keep]
        return TriangleMesh(
            placed, own[keep].astype(np.int32), textures[mine], colors[mine], uv[mine].astype(np.float32)
        )

    return mesh
