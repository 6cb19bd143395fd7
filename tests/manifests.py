"""Manifests changed for tests: as values, and as files whose checksum holds as if a build had written them."""

import json
from dataclasses import replace

from mmi.dataset.reading import Dataset
from mmi.foundation.json_forms import readable_json, with_checksum


def with_cells(dataset, *cells):
    """The dataset with these entries of cells instead of its own."""
    return Dataset(dataset.path, replace(dataset.manifest, cells=cells))


def with_first_cell(dataset, **fields):
    """The dataset with other fields in the entry of its first cell."""
    first, *others = dataset.manifest.cells
    return with_cells(dataset, replace(first, **fields), *others)


def with_first_picture(dataset, **fields):
    """The dataset with other fields for the first picture of its first cell, which is named as these say."""
    entry = dataset.manifest.cells[0]
    k = next(i for i, layers in enumerate(entry.layers) if layers)
    layers = [list(one) for one in entry.layers]
    one = replace(layers[k][0], **fields)
    layers[k][0] = replace(one, name=f"s{k}.l{one.index}" + (f".{one.piece}" if one.piece else ""))
    triangles = sum(one.triangles for sector in layers for one in sector)
    load = replace(entry.frame.layers, triangles=entry.near_triangles + triangles)
    frame = replace(entry.frame, layers=load)
    return with_first_cell(dataset, layers=tuple(map(tuple, layers)), triangles=triangles, frame=frame)


def sign_again(path, edit):
    """Let ``edit`` change the plain values of ``path``'s manifest.json, and write it with the checksum of the changed ones."""
    name = path / "manifest.json"
    document = json.loads(name.read_bytes())
    edit(document)
    name.write_bytes(readable_json(with_checksum(document)))
