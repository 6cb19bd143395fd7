"""Moving objects as a JSON file that has all of them: shapes, and poses over time (``schemas/movers.json``).

Nothing in a file is believed: each mistake is one line that names file, object, pose and what was expected. Angles are degrees
in files and radians in the value.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import PLAIN, TriangleMesh
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.json_forms import json_number, json_object, read_json, shown
from mmi.foundation.whole_files import write_whole
from mmi.movers.movers import LARGEST, Movers

__all__ = ["read_movers", "write_movers"]

_FORMAT, _VERSION = "mmi-traffic", 2
_GREY = 186
_METRES, _DEGREES, _SECONDS = 3, 3, 4
"""Decimals in files. Times have one more than the shortest step needs, so that they still grow when rounded."""
_WITHOUT, _WITH = 5, 7
"""Numbers of a pose without pitch and roll, and with them."""


def read_movers(path: Path) -> Movers:
    """Read what :func:`write_movers`, ``citygen traffic`` or a person wrote.

    Raises ParameterError that names the file, the object, its pose (counted from 1) and what was expected.
    """
    path = Path(path)
    document = read_json(path, "a traffic file")
    try:
        return _movers(document, source=path.name)
    except ParameterError as error:
        said = str(error).removeprefix(f"{path.name}: ")
        raise ParameterError(f"{path}: {said}") from error


def write_movers(movers: Movers, path: Path) -> None:
    """Write them to the millimetre and the thousandth of a degree, one object on each line, whole or not at all.

    Makes the folder. Raises DatasetError where that is impossible.
    """
    write_whole(Path(path), _text(movers).encode("utf-8", errors="backslashreplace"))


def _text(movers: Movers) -> str:
    head = {"format": _FORMAT, "version": _VERSION, "crs": movers.crs, "origin": [float(one) for one in movers.origin]}
    meshes = [
        f"{_json(name)}: {_json(_mesh_to_dict(mesh))}" for name, mesh in zip(movers.names, movers.meshes, strict=True)
    ]
    angles = np.degrees(movers.angles)
    table = (
        np.column_stack([movers.times.round(_SECONDS), movers.positions.round(_METRES), angles.round(_DEGREES)]) + 0.0
    )  # -0.0 reads oddly
    objects = []
    for i, (start, end) in enumerate(itertools.pairwise(movers.starts.tolist())):
        rows = table[start:end]
        level = not rows[:, _WITHOUT:].any()
        one: dict[str, Any] = {"id": movers.ids[i], "mesh": movers.names[movers.kinds[i]]}
        if not movers.stays[i]:
            one["stays"] = False
        objects.append(_json(one | {"poses": _numbers(rows[:, : _WITHOUT if level else _WITH])}))
    shapes, things = ",\n ".join(meshes), ",\n ".join(objects)
    return f'{_json(head)[:-1]},"meshes":{{\n {shapes}\n}},"objects":[\n {things}\n]}}\n'


def _json(value: Any) -> str:  # noqa: ANN401
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _numbers(rows: NDArray[np.float64]) -> list[list[float]]:
    """Whole numbers without a point."""
    return [[int(one) if one == int(one) else one for one in row] for row in rows.tolist()]


def _mesh_to_dict(mesh: TriangleMesh) -> dict[str, Any]:
    return {
        "vertices": _numbers(mesh.vertices.round(_METRES) + 0.0),
        "triangles": mesh.triangles.tolist(),
        "colors": mesh.colors.tolist(),
    }


# ------------------------------------------------------------------------------------------------------------- reading


def _movers(document: object, *, source: str) -> Movers:
    """The value that a file's JSON describes. Raises ParameterError that says where it does not."""
    if (
        isinstance(document, dict)
        and document.get("format") == _FORMAT
        and document.get("version") == 1
        and document["version"] is not True
    ):
        raise ParameterError(
            f'"version": {_VERSION} expected, found 1, which had no shapes; write it anew with citygen'
        )
    top = json_object(
        document, "a traffic file", required=("format", "version", "meshes", "objects"), optional=("crs", "origin")
    )
    if top["format"] != _FORMAT:
        raise ParameterError(f'"format": "{_FORMAT}" expected, found {shown(top["format"])}')
    if isinstance(top["version"], bool) or top["version"] != _VERSION:
        raise ParameterError(f'"version": {_VERSION} expected, found {shown(top["version"])}')
    crs, origin = top.get("crs", "local"), top.get("origin", [0.0, 0.0, 0.0])
    if not (isinstance(crs, str) and crs):
        raise ParameterError(f'"crs": the name of a coordinate system expected, found {shown(crs)}')
    if not (isinstance(origin, list) and len(origin) == 3):
        raise ParameterError(f'"origin": three numbers [x, y, z] expected, found {shown(origin)}')
    x, y, z = (json_number(one, '"origin"', most=1e9) for one in origin)
    if not isinstance(top["meshes"], dict):
        raise ParameterError(f'"meshes": a JSON object of meshes by name expected, found {shown(top["meshes"])}')
    if not isinstance(top["objects"], list):
        raise ParameterError(f'"objects": a list expected, found {shown(top["objects"])}')
    names = tuple(top["meshes"])
    meshes = tuple(_mesh(value, f"mesh {shown(name)}") for name, value in top["meshes"].items())
    kinds, ids, stays, poses = [], [], [], []
    places = {name: i for i, name in enumerate(names)}
    for number, value in enumerate(top["objects"], 1):
        named = value.get("id") if isinstance(value, dict) else None
        where = f"object {named[:80] if isinstance(named, str) and named else number}"
        one = json_object(value, where, required=("id", "mesh", "poses"), optional=("stays",))
        if not (isinstance(one["id"], str) and one["id"]):
            raise ParameterError(f"{where}: id: a name expected, found {shown(one['id'])}")
        if not isinstance(one["mesh"], str) or one["mesh"] not in places:
            raise ParameterError(
                f"{where}: mesh: a name among {shown(list(names))} expected, found {shown(one['mesh'])}"
            )
        if not isinstance(one.get("stays", True), bool):
            raise ParameterError(f"{where}: stays: true or false expected, found {shown(one['stays'])}")
        ids.append(one["id"])
        kinds.append(places[one["mesh"]])
        stays.append(one.get("stays", True))
        poses.append(_poses(one["poses"], where))
    table = np.concatenate([np.empty((0, _WITH)), *poses])
    return Movers(
        tuple(ids),
        np.array(kinds, dtype=np.int64),
        names,
        meshes,
        np.cumsum([0, *map(len, poses)], dtype=np.int64),
        table[:, 0].copy(),
        table[:, 1:4].copy(),
        np.radians(table[:, 4:]),
        np.array(stays, dtype=bool),
        crs,
        (x, y, z),
        source,
    )


def _mesh(value: object, where: str) -> TriangleMesh:
    one = json_object(value, where, required=("vertices", "triangles"), optional=("colors",))
    vertices = _table(one["vertices"], f"{where}: vertices", "vertex", widths=(3,))
    triangles = _table(one["triangles"], f"{where}: triangles", "triangle", widths=(3,), whole=(0, len(vertices) - 1))
    colors = np.full((len(triangles), 3), _GREY, dtype=np.float64)
    if "colors" in one:
        colors = _table(one["colors"], f"{where}: colors", "colour", widths=(3,), whole=(0, 255))
    if len(colors) != len(triangles):
        raise ParameterError(
            f"{where}: colors: one for each of {len(triangles)} triangles expected, found {len(colors)}"
        )
    try:
        return TriangleMesh(
            vertices,
            triangles.astype(np.int32),
            np.full(len(triangles), PLAIN, dtype=np.int32),
            colors.astype(np.uint8),
        )
    except CityError as error:
        raise ParameterError(f"{where}: {error}") from error


def _poses(value: object, where: str) -> NDArray[np.float64]:
    """(k, 7)."""
    return _table(value, f"{where}: poses", "pose", widths=(_WITHOUT, _WITH))


def _table(
    value: object, where: str, row: str, *, widths: Sequence[int], whole: tuple[int, int] | None = None
) -> NDArray[np.float64]:
    """(k, last of ``widths``) the numbers of a list of lists, at least one; shorter rows end in zeros.

    They are up to 1e7, or ``whole`` numbers within these bounds. ``row`` is what one is called.
    """
    if not isinstance(value, list) or not value:
        raise ParameterError(f"{where}: a list of at least one {row} expected, found {shown(value)}")
    for number, one in enumerate(value, 1):
        if not isinstance(one, list) or len(one) not in widths:
            raise ParameterError(
                f"{where}: {row} {number}: {' or '.join(map(str, widths))} numbers expected, found {shown(one)}"
            )
    allowed = {int} if whole else {int, float}
    low, high = whole or (-LARGEST, LARGEST)
    if set(map(type, itertools.chain.from_iterable(value))) <= allowed:
        width = widths[-1]
        rows = value if all(len(one) == width for one in value) else [one + [0.0] * (width - len(one)) for one in value]
        try:
            table = np.array(rows, dtype=np.float64)
        except OverflowError:  # a whole number that no float holds
            table = np.full((1, 1), np.nan)
        if ((low <= table) & (table <= high)).all():
            return table
    kind = f"whole numbers from {low} to {high}" if whole else f"numbers up to {LARGEST:.0f}"
    for number, one in enumerate(value, 1):
        if not all(type(each) in allowed and low <= each <= high for each in one):
            raise ParameterError(f"{where}: {row} {number}: {kind} expected, found {shown(one)}")
    raise AssertionError("a table of good numbers was refused")
