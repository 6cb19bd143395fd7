"""Datasets that are tried: edits that were sealed again, with checksums that hold all the way up, and what must hold of them.

A checksum is no signature: whoever edits a file can write its new checksum too. What is asked of such a dataset is an
MmiError, or values within their ranges; nothing outside of its folder is read.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np

from mmi.dataset.cell_files import read_depths, read_impostor, read_meshes, read_pictures
from mmi.dataset.folder import DatasetFolder
from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import DatasetError
from mmi.foundation.json_forms import with_checksum
from viewer.scene.scene import open_scene

Expect = Callable[[bool, str], None]
"""What is called with whether something holds, and what that is."""
_LIMIT = 1e9
"""Metres and pixels that the schema allows at most."""


def seal_again(seeds: dict[str, bytes], changed: dict[str, bytes], rng: Random) -> dict[str, bytes]:
    """All files, with the checksums of the changed ones in the manifest, and the manifest's and the records' own."""
    return resealed(seeds, changed, sums=rng.random() < 0.7)


def seal_inside(seeds: dict[str, bytes], changed: dict[str, bytes], rng: Random) -> dict[str, bytes]:
    """:func:`seal_again` of a dataset in the folder ``out``; where it is damaged, or not of a dataset, as it is."""

    def inner(files: dict[str, bytes]) -> dict[str, bytes]:
        return {name.removeprefix("out/"): data for name, data in files.items() if name.startswith("out/")}

    sealed = seal_again(inner(seeds), inner(changed), rng)
    return {**seeds, **changed, **{f"out/{name}": data for name, data in sealed.items()}}


def resealed(seeds: dict[str, bytes], changed: dict[str, bytes], *, sums: bool = True) -> dict[str, bytes]:
    """What :func:`seal_again` gives; ``sums`` that the change made wrong are made right as well, where that is possible."""
    files = {**seeds, **changed}
    for name, data in changed.items():
        if name.startswith("cells/") and name.endswith(".json"):
            files[name] = _sealed(data)
        elif name != "manifest.json":
            document = json.loads(files["manifest.json"])
            _seal_files(document, name, data)
            files["manifest.json"] = json.dumps(document).encode()
    data = files["manifest.json"]
    return {**files, "manifest.json": _sealed(_summed_again(data) if sums else data)}


def _sealed(data: bytes) -> bytes:
    try:
        return json.dumps(with_checksum(json.loads(data))).encode()
    except (ValueError, AttributeError, RecursionError):  # NaN, half a character, no object: no checksum exists
        return data


def _seal_files(value: object, name: str, data: bytes) -> None:
    if isinstance(value, dict):
        if value.get("name") == name and "sha256" in value:
            value["bytes"], value["sha256"] = len(data), hashlib.sha256(data).hexdigest()
        for one in value.values():
            _seal_files(one, name, data)
    elif isinstance(value, list):
        for one in value:
            _seal_files(one, name, data)


def _summed_again(data: bytes) -> bytes:
    document = json.loads(data)
    try:
        for cell in document["cells"]:
            cell["triangles"] = sum(one["triangles"] for sector in cell["layers"] for one in sector)
            cell["bytes"] = sum(one["bytes"] for one in cell["files"].values())
        shared = sum(one["bytes"] for one in document["city"]["files"].values())
        document["totals"] = {
            "cells": len(document["cells"]),
            "bytes": shared + sum(one["bytes"] for one in document["cells"]),
        }
    except (KeyError, TypeError, AttributeError, OverflowError):
        return data
    return json.dumps(document).encode()


def try_dataset(folder: Path, expect: Expect) -> None:
    """Open it as every program does, and read all that it names."""
    dataset = open_dataset(folder)
    _check_manifest(dataset.manifest, expect)
    scene = open_scene(dataset, name="fuzz")
    expect(
        bool(np.isfinite(scene.mesh.positions).all() and np.isfinite(scene.mesh.uv).all()), "a mesh that is not finite"
    )
    city = dataset.city()
    for entry in dataset.manifest.cells:
        contents = scene.cell(entry.id)
        expect(bool(np.isfinite(contents.hulls).all()), f"{entry.id}: hulls that are not finite")
        _check_layers(read_impostor(dataset, entry.id, city), expect)


def try_cells(folder: Path, expect: Expect) -> None:
    """Read each cell's files: to draw, for their meshes alone, and to measure. What refuses one need not refuse the other."""
    dataset, refused = open_dataset(folder), []
    for entry in dataset.manifest.cells:
        for read in (read_meshes, read_pictures, read_depths):
            try:
                _check_layers(read(dataset, entry.id), expect)
            except DatasetError as error:
                refused.append(error)
    if refused:
        raise refused[0]


def try_record(folder: Path, expect: Expect) -> None:
    """Take the record as a build does that resumes; one that is not taken changes nothing."""
    (path,) = (folder / "cells").glob("*.json")
    record = DatasetFolder(folder).record(path.stem)
    if record is None:
        raise DatasetError(f"{path.name}: not taken")
    if record.entry is not None:
        _check_entry(record.entry, expect)


def _check_manifest(manifest, expect: Expect) -> None:
    expect(bool(np.isfinite([*manifest.city.origin, manifest.city.ground]).all()), "an origin that is not finite")
    for entry in manifest.cells:
        _check_entry(entry, expect)


def _check_entry(entry, expect: Expect) -> None:
    places = [*entry.axis[0], *entry.axis[1], *entry.eye, *entry.reference, entry.half_width, entry.rise]
    expect(bool(np.isfinite(places).all() and np.abs(places).max() <= _LIMIT), f"{entry.id}: places {places}")
    expect(0 <= entry.texels and 0 <= entry.near_triangles and 0 <= entry.bytes, f"{entry.id}: negative numbers")
    for name in (entry.files.glb, entry.files.exr):
        expect(name is None or (".." not in name.name and not name.name.startswith("/")), f"{entry.id}: {name}")
    for sector, one in entry.pictures:
        numbers = [one.focal, *one.window, *one.depth, one.displacement_px]
        expect(bool(np.isfinite(numbers).all() and np.abs(numbers).max() <= _LIMIT), f"{one.name}: {numbers}")
        expect(one.depth[0] <= one.depth[1], f"{one.name}: depths {one.depth}")
        expect(one.name.startswith(f"s{sector}.l{one.index}"), f"{one.name} in sector {sector}")


def _check_layers(found: object, expect: Expect) -> None:
    layers = getattr(found, "layers", found)
    for one in layers if isinstance(layers, tuple) else ():
        expect(bool(np.isfinite(one.mesh.vertices).all()), f"{one.name}: vertices that are not finite")
