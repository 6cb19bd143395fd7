"""A complete dataset, open for reading: its manifest, and its files held against their checksums."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from mmi import limits
from mmi.city.codec import city_from_json
from mmi.city.model import City
from mmi.dataset.folder import is_ours
from mmi.dataset.manifest import CellEntry, FileEntry, Manifest, manifest_from_json
from mmi.foundation.errors import CityError, DatasetError
from mmi.foundation.whole_files import bytes_within

__all__ = ["Dataset", "open_dataset"]


@dataclass(frozen=True, slots=True, eq=False)
class Dataset:
    """A complete dataset, open for reading; ``manifest`` says what is in it."""

    path: Path
    manifest: Manifest
    _cells: Mapping[str, CellEntry] = field(init=False, repr=False)
    """The manifest's cells by id."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "_cells", {entry.id: entry for entry in self.manifest.cells})

    def cell(self, cell: str) -> CellEntry:
        """A cell's entry in the manifest. Raises DatasetError when there is no such cell."""
        if cell in self._cells:
            return self._cells[cell]
        some = ", ".join(list(self._cells)[:5])
        raise DatasetError(f"{self.path}: no cell {cell!r}; there are {len(self._cells)}, such as {some}")

    def read(self, entry: FileEntry) -> bytes:
        """A file that the manifest names. Raises DatasetError if it is missing or damaged, or not within the dataset."""
        if Path(entry.name).is_absolute() or ".." in Path(entry.name).parts:
            raise DatasetError(
                f"{self.path / 'manifest.json'}: a file name within the dataset expected, found {entry.name!r}"
            )
        name = self.path / entry.name
        try:
            with name.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                data = file.read(entry.bytes) if size == entry.bytes else b""
        except OSError as error:
            raise DatasetError(f"{name}: cannot be read ({error.strerror}); build it again") from error
        if size != entry.bytes:
            raise DatasetError(
                f"{name}: {entry.bytes} bytes expected, as the manifest says, found {size}; "
                "run build-impostors again to mend it"
            )
        if len(data) != entry.bytes or hashlib.sha256(data).hexdigest() != entry.sha256:
            raise DatasetError(
                f"{name}: {entry.bytes} bytes with the manifest's checksum expected, found {len(data)} other bytes; "
                "run build-impostors again to mend it"
            )
        return data

    def city(self) -> City:
        """The city that the dataset was made from. Raises DatasetError if its file is missing or damaged."""
        entry = self.manifest.city.files.json
        try:
            return city_from_json(self.read(entry), name=str(self.path / entry.name))
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
        data = bytes_within(name, limits.MANIFEST_BYTES, DatasetError)
    except OSError as error:
        raise DatasetError(f"{name}: cannot be read ({error.strerror})") from error
    return Dataset(path, manifest_from_json(data, name=str(name)))
