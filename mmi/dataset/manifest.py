"""The manifest as values: what ``manifest.json`` and the records of cells say, checked once where they are read.

The schema (``schemas/manifest.json``) is the single source: what enters is held against it, and then becomes one of these
values, whose fields are the schema's properties, in the same units. Nothing behind this module meets a plain dictionary.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import jsonschema_rs
import numpy as np

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import View, level_view
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.json_forms import canonical_json, readable_json, with_checksum
from mmi.planning.frame_costs import FrameLoad
from mmi.planning.parameters import BuildParameters

__all__ = [
    "FORMAT_VERSION",
    "PROGRAM",
    "CellEntry",
    "CellFiles",
    "CellRecord",
    "CityEntry",
    "CityFiles",
    "FileEntry",
    "FrameEntry",
    "LayerEntry",
    "LoadEntry",
    "Manifest",
    "manifest_from_json",
    "manifest_to_json",
    "record_from_json",
    "record_to_json",
]

FORMAT_VERSION = 10
PROGRAM = "build-impostors"
"""What writes datasets, as ``build.json`` and messages say."""
_CONTRADICTIONS = (ParameterError, ValueError, OverflowError)
"""What is raised where values are of the right kind, and still mean nothing: numbers may be larger than any float."""


@dataclass(frozen=True, slots=True)
class FileEntry:
    """A file of the dataset: its path within the folder, its size in bytes, and its SHA-256 in hexadecimal."""

    name: str
    bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class LayerEntry:
    """One picture of a layer in one sector.

    ``objects`` are places in the cell's list ``far``; ``window`` (left, top, width, height) and ``focal`` are texels; ``depth``
    is metres, nearest and farthest; ``displacement_px`` pixels. The first ``in_order`` of its ``triangles`` can be drawn as
    they are (:mod:`mmi.meshing.ordering`).
    """

    name: str
    index: int
    piece: int
    objects: tuple[int, ...]
    focal: float
    window: tuple[int, int, int, int]
    triangles: int
    in_order: int
    depth: tuple[float, float]
    displacement_px: float


@dataclass(frozen=True, slots=True)
class CellFiles:
    """A cell's files; ``exr`` is None where it has no layers, or the dataset no pictures of them."""

    glb: FileEntry
    exr: FileEntry | None = None


@dataclass(frozen=True, slots=True)
class LoadEntry:
    """What a frame draws in all directions, what of it is the cell's own, and what that costs as a number of triangles."""

    triangles: int
    draws: int
    texels: int
    bytes: int
    cost: float


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """A frame of a cell, stored as one of both: as near objects and layers, and as all geometry that may be visible."""

    layers: LoadEntry
    geometry: LoadEntry


@dataclass(frozen=True, slots=True)
class CellEntry:
    """A viewing cell and its impostor. Metres in the city's frame, pixels of the display; ``layers`` are those of each sector.

    ``promised_error_px`` is None where something in the cell is not bounded, and ``promise_withheld`` says what.
    Raises ValueError where numbers contradict each other, ParameterError where it is no viewing cell.
    """

    id: str
    street: str
    axis: tuple[tuple[float, float], tuple[float, float]]
    half_width: float
    eye: tuple[float, float]
    rise: float
    reference: tuple[float, float, float]
    neighbours: tuple[str, ...]
    near: tuple[str, ...]
    far: tuple[str, ...]
    layers: tuple[tuple[LayerEntry, ...], ...]
    triangles: int
    near_triangles: int
    texels: int
    bytes: int
    frame: FrameEntry
    promised_error_px: float | None
    promise_withheld: str | None
    largest_weight_px: float
    missed_px: float | None
    displacement_px: float
    files: CellFiles

    def __post_init__(self) -> None:
        _ = self.viewing_cell  # which checks what it is made of
        numbers = (*self.reference, self.largest_weight_px, self.missed_px or 0.0, self.displacement_px)
        if not all(math.isfinite(float(one)) for one in numbers):
            raise ValueError(f"finite numbers expected, found {numbers}")
        if self.triangles != sum(one.triangles for _, one in self.pictures):
            raise ValueError(f"as many triangles as its layers have expected, found {self.triangles}")
        for sector, one in self.pictures:
            name = f"s{sector}.l{one.index}" + (f".{one.piece}" if one.piece else "")
            if one.name != name:
                raise ValueError(f"sector {sector}: the name {name} expected, found {one.name}")
            if one.depth[0] > one.depth[1]:
                raise ValueError(f"{one.name}: depths, nearest and farthest, expected, found {one.depth}")
            if max(one.objects) >= len(self.far):
                raise ValueError(f"{one.name}: places below {len(self.far)} in far expected, found {max(one.objects)}")
            if one.in_order > one.triangles:
                raise ValueError(
                    f"{one.name}: at most {one.triangles} triangles in order expected, found {one.in_order}"
                )
        if (self.promised_error_px is None) == (self.promise_withheld is None):
            raise ValueError("either promised_error_px or promise_withheld expected")
        if self.files.exr is not None and not self.pictures:
            raise ValueError("an EXR expected where there are layers only")

    @property
    def viewing_cell(self) -> ViewingCell:
        """The cell itself."""
        return ViewingCell(self.id, *self.axis, self.half_width, self.eye, self.street, self.rise)

    @property
    def pictures(self) -> list[tuple[int, LayerEntry]]:
        """(sector, entry) of each picture of a layer."""
        return [(sector, one) for sector, layers in enumerate(self.layers) for one in layers]

    @property
    def layer_count(self) -> int:
        """How many layers there are, however many pictures each has."""
        return len({one.index for _, one in self.pictures})

    def view(self, sector: int, layer: LayerEntry) -> View:
        """The view in which a layer of a sector was captured."""
        azimuth = 2.0 * np.pi / len(self.layers) * sector
        return level_view(np.array(self.reference), azimuth, focal=layer.focal, window=layer.window)


@dataclass(frozen=True, slots=True)
class CityFiles:
    """The files that all cells share: objects and streets, and their geometry."""

    json: FileEntry
    glb: FileEntry


@dataclass(frozen=True, slots=True)
class CityEntry:
    """The city: where it was read from, its coordinate system, metres subtracted from it, and its size."""

    source: str
    crs: str
    origin: tuple[float, float, float]
    ground: float
    objects: int
    triangles: int
    files: CityFiles


@dataclass(frozen=True, slots=True)
class Manifest:
    """What is in a dataset; ``cells`` are sorted by id."""

    city: CityEntry
    parameters: BuildParameters
    cells: tuple[CellEntry, ...]

    @property
    def bytes(self) -> int:
        """Of all files that the manifest names."""
        shared = self.city.files.json.bytes + self.city.files.glb.bytes
        return shared + sum(cell.bytes for cell in self.cells)


@dataclass(frozen=True, slots=True)
class CellRecord:
    """What a build notes of a cell that it finished: fingerprints of what it was made from, and its entry.

    ``entry`` is None where the cell was cut in halves, which have records of their own.
    """

    inputs: str
    content: str
    entry: CellEntry | None


# ------------------------------------------------------------------------------------------------------- to JSON


def manifest_to_json(manifest: Manifest) -> bytes:
    """``manifest.json``, with its checksum."""
    document = {
        "format_version": FORMAT_VERSION,
        "city": asdict(manifest.city),
        "parameters": manifest.parameters.as_dict(),
        "cells": [_cell_to_dict(cell) for cell in manifest.cells],
        "totals": {"cells": len(manifest.cells), "bytes": manifest.bytes},
    }
    return readable_json(with_checksum(document))


def record_to_json(record: CellRecord) -> bytes:
    """A cell's record, with its checksum."""
    entry = None if record.entry is None else _cell_to_dict(record.entry)
    return canonical_json(with_checksum({"inputs": record.inputs, "content": record.content, "entry": entry}))


def _cell_to_dict(cell: CellEntry) -> dict[str, Any]:
    document = asdict(cell)
    if cell.files.exr is None:
        del document["files"]["exr"]
    return document


# ----------------------------------------------------------------------------------------------------- from JSON


def manifest_from_json(data: bytes, *, name: str) -> Manifest:
    """The inverse of :func:`manifest_to_json`; ``name`` is what messages call the file.

    Raises DatasetError where the data are no JSON, of another version, changed since they were written, or not as the schema
    describes them.
    """
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{name}: JSON expected, found damaged data ({error})") from error
    version = document.get("format_version") if isinstance(document, dict) else None
    if version != FORMAT_VERSION:
        raise DatasetError(f"{name}: format version {FORMAT_VERSION} expected, found {version!r}; build it again")
    if not _is_whole(document):
        raise DatasetError(
            f"{name}: the checksum that {PROGRAM} wrote expected, found other contents; run {PROGRAM} again to mend it"
        )
    _hold_against_schema("manifest", document, name)
    try:
        parameters = BuildParameters.from_dict(document["parameters"])
        cells = tuple(_cell_from_dict(cell) for cell in document["cells"])
        names = {cell.id for cell in cells}
        if len(names) < len(cells):
            raise ValueError(f"{len(cells)} cells of different ids expected, found {len(names)}")
        for cell in cells:
            if cell.promised_error_px not in (None, parameters.max_error_px):
                raise ValueError(f"cell {cell.id}: a promise of {parameters.max_error_px:g} px or none expected")
            _within_the_display(cell, parameters)
            drawn = cell.near_triangles + cell.triangles
            if cell.pictures and cell.frame.layers.triangles != drawn:
                raise ValueError(
                    f"cell {cell.id}: a frame of {drawn} triangles expected, found {cell.frame.layers.triangles}"
                )
            for load in (cell.frame.layers, cell.frame.geometry):
                cost = FrameLoad(load.triangles, load.draws, load.texels, load.bytes).cost(parameters.costs)
                if not math.isclose(load.cost, cost, rel_tol=1e-9):
                    raise ValueError(
                        f"cell {cell.id}: a frame that costs {cost:g} triangles expected, found {load.cost:g}"
                    )
            if (cell.files.exr is not None) != (bool(cell.pictures) and parameters.pictures == "all"):
                raise ValueError(f"cell {cell.id}: an EXR expected where there are pictures of layers, and only there")
    except _CONTRADICTIONS as error:
        raise DatasetError(f"{name}: values as {PROGRAM} writes them expected, found others ({error})") from error
    city = document["city"]
    shared = CityFiles(**{key: FileEntry(**file) for key, file in city["files"].items()})
    entry = CityEntry(**{**city, "origin": tuple(city["origin"]), "files": shared})
    manifest = Manifest(entry, parameters, cells)
    if document["totals"] != {"cells": len(cells), "bytes": manifest.bytes}:
        raise DatasetError(f"{name}: totals of {len(cells)} cells and {manifest.bytes} bytes expected, found others")
    return manifest


def _within_the_display(cell: CellEntry, parameters: BuildParameters) -> None:
    """Raises ValueError where a cell has sectors or errors in pixels that these parameters cannot lead to."""
    if len(cell.layers) != parameters.sectors:
        raise ValueError(f"cell {cell.id}: {parameters.sectors} sectors expected, found {len(cell.layers)}")
    camera = parameters.camera
    right_angle = camera.pixels_from_angle(0.5 * math.pi)
    around = 2.0 * math.pi / camera.border_pixel[0]
    for name, value, most in (
        *((f"{one.name}: displacement_px", one.displacement_px, cell.displacement_px) for _, one in cell.pictures),
        ("displacement_px", cell.displacement_px, right_angle),
        ("largest_weight_px", cell.largest_weight_px, right_angle),
        ("missed_px", cell.missed_px or 0.0, around),
    ):
        if not value <= most * (1.0 + 1e-9):
            raise ValueError(f"cell {cell.id}: {name} of at most {most:g} expected, found {value:g}")
    wrong = max(cell.displacement_px, cell.missed_px or 0.0)
    if cell.pictures and cell.promised_error_px is not None and wrong > cell.promised_error_px:
        raise ValueError(
            f"cell {cell.id}: no promise expected, where up to {cell.displacement_px:g} px are displaced and "
            f"{cell.missed_px or 0.0:g} px missed"
        )


def record_from_json(data: bytes) -> CellRecord:
    """The inverse of :func:`record_to_json`. Raises DatasetError where the data are damaged or not a record of this version."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"a record: JSON expected, found damaged data ({error})") from error
    if not isinstance(document, dict) or not _is_whole(document):
        raise DatasetError(f"a record: the checksum that {PROGRAM} wrote expected, found other contents")
    _hold_against_schema("record", document, "a record")
    try:
        entry = None if document["entry"] is None else _cell_from_dict(document["entry"])
    except _CONTRADICTIONS as error:
        raise DatasetError(f"a record: values as {PROGRAM} writes them expected, found others ({error})") from error
    return CellRecord(document["inputs"], document["content"], entry)


def _is_whole(document: Mapping[str, Any]) -> bool:
    """Whether the checksum in ``document`` is that of the rest of it."""
    try:
        return bool(with_checksum(document)["checksum"] == document.get("checksum"))
    except (ValueError, RecursionError):  # no canonical JSON: it holds NaN, half a character, or lists a thousand deep
        return False


@cache
def _validator(name: str) -> jsonschema_rs.Draft202012Validator:
    """The validator of ``manifest.json``, or of a cell's record, whose entry is a cell of the manifest."""
    schema = json.loads((files("mmi.dataset") / "schemas" / "manifest.json").read_bytes())
    if name == "record":
        own = json.loads((files("mmi.dataset") / "schemas" / "record.json").read_bytes())
        schema = {**own, "$defs": schema["$defs"]}
    return jsonschema_rs.Draft202012Validator(schema)


def _hold_against_schema(schema: str, document: Mapping[str, Any], name: str) -> None:
    try:
        _validator(schema).validate(document)
    except jsonschema_rs.ValidationError as error:
        place = "/".join(map(str, error.instance_path)) or "the document"
        raise DatasetError(
            f"{name}: values as its schema describes them expected, found {place}: {error.message}"
        ) from error
    except UnicodeEncodeError as error:
        raise DatasetError(f"{name}: text expected, found half a character ({error.reason})") from error


def _cell_from_dict(cell: Mapping[str, Any]) -> CellEntry:
    p, q = cell["axis"]
    return CellEntry(
        **{
            **cell,
            "axis": (tuple(p), tuple(q)),
            "layers": tuple(tuple(_layer_from_dict(one) for one in sector) for sector in cell["layers"]),
            "files": CellFiles(**{key: FileEntry(**file) for key, file in cell["files"].items()}),
            "frame": FrameEntry(**{key: LoadEntry(**load) for key, load in cell["frame"].items()}),
            **{name: tuple(cell[name]) for name in ("eye", "reference", "neighbours", "near", "far")},
        }
    )


def _layer_from_dict(layer: Mapping[str, Any]) -> LayerEntry:
    return LayerEntry(**{**layer, **{name: tuple(layer[name]) for name in ("objects", "window", "depth")}})
