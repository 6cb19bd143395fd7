"""The dataset on disk: a folder that a killed build can resume, and that tells when it was damaged.

    OUT/manifest.json      what is in it; the same bytes for the same city and parameters (schemas/manifest.json)
    OUT/build.json         what the machine did; the only file that differs between builds (schemas/build.json)
    OUT/city.json          objects and streets;  OUT/city.glb  their geometry, shared by all cells
    OUT/cells/ID.json      a cell's record: its entry in the manifest, and what it was made from (schemas/record.json)
    OUT/cells/ID.exr       its depth textures;   OUT/cells/ID.glb  its layers' meshes and textures

Files are written under a temporary name and renamed. A cell's record comes last: where it is there, and its checksums hold,
the cell is complete. Manifest and records carry checksums of their own and are held against their schemas when they are read
(:mod:`mmi.dataset.manifest`). Nothing is ever unpickled.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import stat
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mmi import limits
from mmi.dataset.manifest import (
    FORMAT_VERSION,
    PROGRAM,
    CellRecord,
    FileEntry,
    record_from_json,
    record_to_json,
)
from mmi.foundation.errors import DatasetError
from mmi.foundation.json_forms import readable_json
from mmi.foundation.whole_files import bytes_within, is_leftover, whole_path

__all__ = ["DatasetFolder", "build_folder", "is_ours", "make_folder"]


@dataclass(frozen=True, slots=True)
class DatasetFolder:
    """A dataset's folder, open for building; get one from :func:`build_folder`. Raises DatasetError when it cannot write."""

    path: Path

    def write(self, name: str, data: bytes) -> FileEntry:
        """Write a file whole or not at all; its entry. Unchanged files stay untouched."""
        target = self.path / name
        entry = FileEntry(name, len(data), hashlib.sha256(data).hexdigest())
        if _checksum(target) == (entry.bytes, entry.sha256):
            return entry
        return self.write_with(name, lambda temporary: _write_bytes(temporary, data))

    def write_with(self, name: str, write: Callable[[Path], None]) -> FileEntry:
        """The same for a library that writes to a path itself."""
        target = self.path / name
        try:
            with whole_path(target, make_folder=False) as temporary:
                write(temporary)
                found = _checksum(temporary)
        except (OSError, RuntimeError) as error:  # OpenEXR raises RuntimeError
            raise _cannot_write(target, error) from error
        if found is None:
            raise DatasetError(f"{target}: written, but it cannot be read back")
        return FileEntry(name, *found)

    def read(self, name: str) -> bytes:
        """A file's bytes. Raises DatasetError if it cannot be read."""
        try:
            return (self.path / name).read_bytes()
        except OSError as error:
            raise DatasetError(f"{self.path / name}: cannot be read ({error.strerror})") from error

    def record(self, cell: str, *, check: bool = True) -> CellRecord | None:
        """A complete cell's record; None where there is none, or where it or a file that it names is damaged.

        Without ``check`` the files are not read: for a cell that this build has just written or checked.
        """
        try:
            record = record_from_json(_record_bytes(self.path / "cells" / f"{cell}.json"))
        except (OSError, DatasetError):
            return None
        entry = record.entry
        if entry is None:
            return record
        files = [one for one in (entry.files.glb, entry.files.exr) if one is not None]
        if entry.id != cell or any(Path(one.name).with_suffix("") != Path("cells") / cell for one in files):
            return None
        damaged = check and any(_checksum(self.path / one.name) != (one.bytes, one.sha256) for one in files)
        return None if damaged else record

    def write_record(self, cell: str, record: CellRecord) -> None:
        """Declare a cell complete."""
        self.write(f"cells/{cell}.json", record_to_json(record))

    def stray_cells(self, present: Collection[str]) -> list[str]:
        """Ids of recorded cells that are not ``present``, whatever version of the format recorded them, sorted.

        Files that are no records are none, and only those of other names are read.
        """
        strays = (path for path in (self.path / "cells").glob("*.json") if path.stem not in present)
        return sorted(path.stem for path in strays if _is_record(path))

    def remove_cell(self, cell: str) -> None:
        """Delete a cell's files, its record first."""
        for suffix in (".json", ".exr", ".glb"):
            self.remove(f"cells/{cell}{suffix}")

    def remove(self, name: str) -> None:
        """Delete a file, where there is one."""
        try:
            (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            raise _cannot_write(self.path / name, error) from error


def make_folder(path: Path) -> None:
    """Make ``path`` a folder that a dataset can be built in, changing nothing in a folder that holds something else.

    Raises DatasetError when it is a file, a folder of other files, or cannot be made.
    """
    if path.exists() and not path.is_dir():
        raise DatasetError(f"{path}: a folder for the dataset expected, found a file")
    if path.is_symlink() and not path.exists():
        raise DatasetError(f"{path}: a folder for the dataset expected, found a link that leads nowhere")
    try:
        present = {entry.name for entry in path.iterdir() if not _is_blank(entry)} if path.exists() else set()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror})") from error
    if present and not is_ours(path):
        some = ", ".join(sorted(present)[:3])
        raise DatasetError(
            f"{path}: a new or empty folder, or a dataset of {PROGRAM}, expected; found other files ({some}); "
            "nothing was changed"
        )
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(path, error) from error


@contextmanager
def build_folder(path: Path) -> Iterator[DatasetFolder]:
    """Make or reopen ``path`` for building, alone: a lock keeps a second build out for as long as this process lives.

    Raises DatasetError when the folder holds something else, is in use by another build, or cannot be written.
    """
    path = Path(path)
    make_folder(path)
    with _locked(path):
        folder = DatasetFolder(path)
        if not (path / "build.json").exists():
            folder.write("build.json", readable_json({"program": PROGRAM, "format_version": FORMAT_VERSION}))
        for one in [*path.iterdir(), *(path / "cells").iterdir()]:
            if is_leftover(one):
                one.unlink(missing_ok=True)
        yield folder


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the folder's lock for the block, then remove it.

    Another build may have opened the lock's file just before it is removed here, and would then lock a file that nobody finds
    any more; so a lock counts only while it is the file that has its name.
    """
    name, cells = path / ".lock", path / "cells"
    if cells.is_symlink() or (cells.exists() and not cells.is_dir()):
        found = "a link" if cells.is_symlink() else "a file"
        raise DatasetError(f"{cells}: a folder for the dataset's cells expected, found {found}; remove it")
    while True:
        try:
            cells.mkdir(exist_ok=True)
        except OSError as error:
            raise _cannot_write(path, error) from error
        try:
            lock = os.fdopen(os.open(name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666), "r+b")
        except OSError as error:
            if name.is_symlink() or (name.exists() and not name.is_file()):
                found = "a link" if name.is_symlink() else "another kind of file"
                raise DatasetError(f"{name}: a file of a build's own expected, found {found}; remove it") from error
            raise _cannot_write(path, error) from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise DatasetError(
                    f"{path}: another {PROGRAM} is writing here; wait for it or stop it first"
                ) from error
            try:
                if not os.path.samestat(os.fstat(lock.fileno()), name.stat()):
                    continue
            except FileNotFoundError:
                continue
            try:
                yield
            finally:
                name.unlink(missing_ok=True)
            return


def _is_blank(entry: Path) -> bool:
    """Whether this is what a build leaves in its folder that was killed before it could sign it with ``build.json``."""
    if entry.name == "cells":
        return entry.is_dir() and not any(entry.iterdir())
    return entry.name == ".lock" or is_leftover(entry, "build.json")


def is_ours(path: Path) -> bool:
    """Whether a folder holds a dataset, or the beginnings of one, by its ``build.json``."""
    try:
        marker = json.loads(_record_bytes(path / "build.json"))
    except (OSError, ValueError, RecursionError, DatasetError):
        return False
    return isinstance(marker, dict) and marker.get("program") == PROGRAM


def _record_bytes(path: Path) -> bytes:
    """What a small file of a build's own holds. Raises OSError where it cannot be read, DatasetError where it is too large."""
    return bytes_within(path, limits.RECORD_BYTES, DatasetError)


def _is_record(path: Path) -> bool:
    """Whether a file is what some version of this program noted of a cell, whole or not."""
    try:
        record = json.loads(_record_bytes(path))
    except (OSError, ValueError, RecursionError, DatasetError):
        return False
    return isinstance(record, dict) and {"inputs", "content", "entry"} <= set(record)


def _checksum(path: Path) -> tuple[int, str] | None:
    """(bytes, sha256) of a file, None where it cannot be read, or is a link, a pipe or a device, which might never end."""
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            state = os.fstat(file.fileno())
            if not stat.S_ISREG(state.st_mode):
                return None
            return state.st_size, hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _write_bytes(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)


def _cannot_write(path: Path, error: BaseException) -> DatasetError:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    if isinstance(error, OSError):
        reason = error.strerror or reason
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            return DatasetError(
                f"{path}: the disk is full ({reason}); make room and run the same command again: finished cells are kept"
            )
    return DatasetError(f"{path}: cannot be written ({reason}); finished cells are kept")
