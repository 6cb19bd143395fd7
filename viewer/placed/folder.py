"""The folder that ``place-images`` writes, and how it is read.

    DIR/place-images.json says whose folder it is, from the first moment on
    DIR/manifest.json     for whom: program, versions, and totals; written last, so that a folder that has it is complete
    DIR/solutions.bin     grid, images of its points, model, display, budget (``viewer.placed.solutions``)
    DIR/images/N-KEY.ldi  image N (``viewer.layered.image_codec``), and the SHA-256 of that; KEY is of all that it was made from

Nothing is trusted that is read, and nothing is unpickled.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.json_forms import read_json, readable_json
from mmi.foundation.processes import package_version
from mmi.foundation.whole_files import bytes_within, is_leftover, write_whole
from viewer.layered.image_codec import decoded
from viewer.layered.layered_image import LayeredImage
from viewer.placed.solutions import Solutions, solutions_from, solutions_to_bytes
from viewer.placing.rules import FrameBudget

__all__ = [
    "FORMAT_VERSION",
    "PROGRAM",
    "WORKING",
    "PlacedFolder",
    "folder_of",
    "open_placed",
    "placing_folder",
    "read_manifest",
    "read_solutions",
    "write_manifest",
]

PROGRAM = "place-images"
FORMAT_VERSION = 3
WORKING = ".meshes-"
"""What folders are called that are there only while images are made."""
_SOLUTIONS_BYTES = 1 << 30
_IMAGE_BYTES = 1 << 28
_SUM = 32
_SOLUTIONS, _MANIFEST, _MARKER = "solutions.bin", "manifest.json", "place-images.json"


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFolder:
    """A folder with the ``solutions`` that it holds, whose images have ``key`` in their names."""

    path: Path
    solutions: Solutions
    key: str

    def file(self, number: int) -> Path:
        """Where an image is."""
        return self.path / "images" / f"{number:06d}-{self.key}.ldi"

    def write_image(self, number: int, data: bytes) -> None:
        """Keep an image's bytes. Raises DatasetError where they cannot be written."""
        write_whole(self.file(number), data + hashlib.sha256(data).digest())

    def image_bytes(self, number: int) -> bytes:
        """The bytes of an image. Raises DatasetError where its file is missing or damaged."""
        path = self.file(number)
        try:
            data = bytes_within(path, _IMAGE_BYTES, DatasetError)
        except OSError as error:
            raise DatasetError(f"{path}: cannot be read ({error.strerror}); run {PROGRAM} again") from error
        if hashlib.sha256(data[:-_SUM]).digest() != data[-_SUM:]:
            raise DatasetError(f"{path}: damaged: its checksum is another; run {PROGRAM} again")
        return data[:-_SUM]

    def has_image(self, number: int) -> bool:
        """Whether an image is there, whole."""
        try:
            self.image_bytes(number)
        except DatasetError:
            return False
        return True

    def image(self, number: int) -> LayeredImage:
        """An image. Raises DatasetError where its file is missing, damaged, or that of another image."""
        found, view = decoded(self.image_bytes(number), str(self.file(number))), self.solutions.view(number)
        same = found.view.window == view.window and found.view.focal == view.focal
        if not (same and np.allclose(found.view.eye_from_world, view.eye_from_world, rtol=0.0, atol=1e-9)):
            raise DatasetError(f"{self.file(number)}: image {number} expected, found another; run {PROGRAM} again")
        return found


def folder_of(path: Path, solutions: Solutions | None = None) -> PlacedFolder:
    """The folder at ``path`` for the ``solutions`` that are to be in it, or that are there. It is not finished any more where
    others were there.

    Raises DatasetError where they are missing or damaged, or cannot be written.
    """
    if solutions is None:
        solutions = read_solutions(path)
        data = solutions_to_bytes(solutions)
    else:
        data = solutions_to_bytes(solutions)
        file = path / _SOLUTIONS
        if not file.is_file() or file.read_bytes() != data:
            (path / _MANIFEST).unlink(missing_ok=True)  # it is of others, whose images it would show for these
            write_whole(file, data)
    told = hashlib.sha256(f"{FORMAT_VERSION} {package_version()} ".encode() + data)
    return PlacedFolder(path, solutions, told.hexdigest()[:12])


def read_solutions(path: Path) -> Solutions:
    """What ``solutions.bin`` of a folder says. Raises DatasetError where it is missing or damaged."""
    file = path / _SOLUTIONS
    try:
        data = bytes_within(file, _SOLUTIONS_BYTES, DatasetError)
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read ({error.strerror}); run {PROGRAM} again") from error
    return solutions_from(data, str(file))


def open_placed(path: Path) -> PlacedFolder:
    """The folder at ``path``, which a finished run of the program has left.

    Raises DatasetError where it is none, was not finished, or is damaged.
    """
    path = Path(path)
    if not path.is_dir():
        raise DatasetError(
            f"{path}: a folder that {PROGRAM} wrote expected, found {'a file' if path.exists() else 'none'}"
        )
    if not (path / _MANIFEST).exists():
        unfinished = (path / _SOLUTIONS).exists()
        found = "one that is not finished: run the same command again" if unfinished else "another"
        raise DatasetError(f"{path}: a folder that {PROGRAM} wrote expected, found {found}")
    manifest = read_manifest(path)
    solutions = read_solutions(path)
    if manifest["images"] != len(solutions.images):
        raise DatasetError(
            f"{path / 'manifest.json'}: {len(solutions.images)} images expected, found {manifest['images']}"
        )
    return PlacedFolder(path, solutions, manifest["key"])


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of the folder at ``path``. Raises DatasetError where it is none of this program's."""
    file = path / _MANIFEST
    try:
        found = read_json(file, f"the manifest of {PROGRAM}")
    except ParameterError as error:
        raise DatasetError(str(error)) from error
    if not isinstance(found, dict) or found.get("program") != PROGRAM:
        raise DatasetError(f"{file}: the manifest of {PROGRAM} expected, found another")
    if found.get("format_version") != FORMAT_VERSION:
        raise DatasetError(
            f"{file}: format version {FORMAT_VERSION} expected, found {json.dumps(found.get('format_version'))[:40]}; run "
            f"{PROGRAM} again"
        )
    key = found.get("key")
    if not (isinstance(key, str) and len(key) == 12 and set(key) <= set("0123456789abcdef")):
        raise DatasetError(f"{file}: the key of its images expected, found {json.dumps(key)[:40]}")
    if type(found.get("images")) is not int:
        raise DatasetError(f"{file}: a number of images expected, found {json.dumps(found.get('images'))[:40]}")
    return found


@contextmanager
def placing_folder(path: Path) -> Iterator[Path]:
    """Make or reopen the folder at ``path`` for placing images, alone, for the block.

    Raises DatasetError when it is a file, holds something else, is in use by another run, or cannot be written.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise DatasetError(f"{path}: a folder for the images expected, found a file")
    try:
        path.mkdir(parents=True, exist_ok=True)
        present = [one for one in path.iterdir() if not is_leftover(one) and one.name != ".lock"]
        if present and not (path / _MARKER).is_file():
            some = ", ".join(sorted(one.name for one in present)[:3])
            raise DatasetError(
                f"{path}: a new or empty folder, or one of {PROGRAM}, expected; found other files ({some}); nothing was changed"
            )
        with (path / ".lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise DatasetError(
                    f"{path}: another {PROGRAM} is writing here; wait for it or stop it first"
                ) from error
            write_whole(path / _MARKER, readable_json({"program": PROGRAM, "format_version": FORMAT_VERSION}))
            images = path / "images"
            images.mkdir(exist_ok=True)
            for one in (*path.iterdir(), *images.iterdir()):
                if is_leftover(one):
                    one.unlink(missing_ok=True)
            for one in path.glob(f"{WORKING}*"):  # of a run that was killed
                shutil.rmtree(one, ignore_errors=True)
            yield path
    except OSError as error:
        raise DatasetError(
            f"{path}: cannot be written ({error.strerror or error}); what was finished is kept"
        ) from error


def write_manifest(folder: PlacedFolder, frame: FrameBudget | None = None) -> int:
    """Say that a folder is complete, and what ``frame`` its budget is from; remove images of earlier runs. The bytes of all
    images.

    Raises DatasetError where an image is missing or damaged.
    """
    solutions = folder.solutions
    sizes = [len(folder.image_bytes(number)) for number in range(len(solutions.images))]
    names = {folder.file(number).name for number in range(len(sizes))}
    for one in (folder.path / "images").glob("*.ldi"):
        if one.name not in names:
            one.unlink(missing_ok=True)
    camera, rules = solutions.camera, solutions.rules
    told = {
        "program": PROGRAM,
        "format_version": FORMAT_VERSION,
        "version": package_version(),
        "key": folder.key,
        "model": {"source": solutions.source, "fingerprint": solutions.model},
        "display": {"width": camera.width, "height": camera.height, "fov_degrees": math.degrees(camera.fov)},
        "budget": rules.budget,
        "optimize": rules.target,
        "pitch_degrees": math.degrees(rules.pitch),
        "hidden": bool(solutions.occluders),
        "pictures": solutions.pictures,
        "points": len(solutions.points),
        "images": len(sizes),
        "bytes": sum(sizes),
        "most_triangles": max(int(one.counts.max()) for one in solutions.points),
        "frame_ms": None if frame is None else asdict(frame),
    }
    write_whole(folder.path / _MANIFEST, readable_json(told))
    return sum(sizes)
