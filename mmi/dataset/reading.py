"""A complete dataset, open for reading: its manifest, and its files held against their checksums."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mmi.city.codec import city_from_json
from mmi.city.model import City
from mmi.dataset.folder import FORMAT_VERSION, PROGRAM, is_ours
from mmi.foundation.errors import CityError, DatasetError
from mmi.foundation.json_forms import with_checksum

__all__ = ["Dataset", "open_dataset"]


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """A complete dataset, open for reading. ``manifest`` is its manifest.json as plain values."""

    path: Path
    manifest: Mapping[str, Any]
    _cells: Mapping[str, Mapping[str, Any]] = field(init=False, repr=False)
    """The manifest's cells by id."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_cells", {entry["id"]: entry for entry in self.manifest["cells"]})

    def cell(self, cell: str) -> Mapping[str, Any]:
        """A cell's entry in the manifest. Raises DatasetError when there is no such cell."""
        if cell in self._cells:
            return dict(self._cells[cell])
        some = ", ".join(list(self._cells)[:5])
        raise DatasetError(f"{self.path}: no cell {cell!r}; there are {len(self._cells)}, such as {some}")

    def read(self, entry: Mapping[str, Any]) -> bytes:
        """A file that the manifest names (``{name, bytes, sha256}``). Raises DatasetError if it is missing or damaged."""
        name = str(entry["name"])
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise DatasetError(
                f"{self.path / 'manifest.json'}: a file name within the dataset expected, found {name!r}"
            )
        try:
            data = (self.path / name).read_bytes()
        except OSError as error:
            raise DatasetError(f"{self.path / name}: cannot be read ({error.strerror}); build it again") from error
        if len(data) != entry["bytes"] or hashlib.sha256(data).hexdigest() != entry["sha256"]:
            raise DatasetError(
                f"{self.path / name}: {entry['bytes']} bytes with the manifest's checksum expected, found {len(data)} "
                "other bytes; run build-impostors again to mend it"
            )
        return data

    def city(self) -> City:
        """The city that the dataset was made from. Raises DatasetError if its file is missing or damaged."""
        entry = self.manifest["city"]["files"]["json"]
        try:
            return city_from_json(self.read(entry), name=str(self.path / entry["name"]))
        except CityError as error:
            raise DatasetError(str(error)) from error


def open_dataset(path: Path) -> Dataset:
    """Open a dataset for reading.

    Raises DatasetError when there is none, or its manifest is of another version or not as build-impostors wrote it.
    """
    path = Path(path)
    name = path / "manifest.json"
    if not path.is_dir():
        raise DatasetError(
            f"{path}: the folder of a dataset expected, found {'a file' if path.exists() else 'nothing'}"
        )
    if not name.exists():
        hint = "its build was not finished: run build-impostors again" if is_ours(path) else "it is not a dataset"
        raise DatasetError(f"{path}: no manifest.json here; {hint}")
    try:
        manifest = json.loads(name.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{name}: JSON expected, found damaged data ({error})") from error
    version = manifest.get("format_version") if isinstance(manifest, dict) else None
    if version != FORMAT_VERSION:
        raise DatasetError(f"{name}: format version {FORMAT_VERSION} expected, found {version!r}; build it again")
    try:
        whole = with_checksum(manifest)["checksum"] == manifest.get("checksum")
    except ValueError:  # no canonical JSON: it holds NaN, or half a character
        whole = False
    if not whole:
        raise DatasetError(
            f"{name}: the checksum that {PROGRAM} wrote expected, found other contents; run {PROGRAM} again to mend it"
        )
    return Dataset(path, manifest)
