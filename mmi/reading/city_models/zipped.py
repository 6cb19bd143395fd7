"""A zip of CityGML or CityJSON tiles, as cities offer it for download: unpacked for as long as it is read.

Only models and pictures are unpacked, into a folder of their own that goes afterwards. Names that lead out of it are passed
over. What would fill the disk is refused by the sizes that the zip states; no more than these is ever written.
"""

from __future__ import annotations

import re
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.foundation.whole_files import in_words

__all__ = ["unpacked_tiles"]

_MODELS = (".gml", ".xml", ".json", ".jsonl")
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".gif", ".tga")
_HEAD = 8192
_CITYJSON = re.compile(rb'"type"\s*:\s*"CityJSON(Feature)?"|"CityObjects"')
_DAMAGE = (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, ValueError, EOFError, OSError)
"""What Python raises on a zip that is cut off, encrypted, packed in an unknown way, or does not fit on the disk."""


@contextmanager
def unpacked_tiles(path: Path) -> Iterator[list[Path]]:
    """The city models in the zip ``path``, by name, with the pictures beside them; none where it is no zip of such.

    Raises:
        CityError: the zip is damaged, too large, or holds models of both kinds. Errors of who reads the tiles name the zip.
    """
    if not (path.is_file() and zipfile.is_zipfile(path)):
        yield []
        return
    with tempfile.TemporaryDirectory(prefix="tiles-") as name:
        folder = Path(name)
        try:
            tiles = _unpacked(path, folder)
        except _DAMAGE as error:
            raise CityError(f"{path}: expected a zip of city models, complete and open; found: {error}") from error
        try:
            yield tiles
        except CityError as error:
            raise CityError(str(error).replace(f"{folder}/", f"{path}/")) from error


def _unpacked(path: Path, folder: Path) -> list[Path]:
    with zipfile.ZipFile(path) as archive:
        entries = [one for one in archive.infolist() if not one.is_dir() and _stays_inside(one.filename)]
        kinds = {one.filename: _kind(archive, one) for one in entries if one.filename.lower().endswith(_MODELS)}
        found = set(kinds.values()) - {""}
        if not found:
            return []
        if len(found) > 1:
            raise CityError(f"{path}: tiles of one kind expected, found both CityGML and CityJSON")
        wanted = [one for one in entries if kinds.get(one.filename) or one.filename.lower().endswith(_PICTURES)]
        size = sum(one.file_size for one in wanted)
        if size > limits.ZIP_BYTES or len(wanted) > limits.ZIP_FILES:
            raise CityError(
                f"{path}: at most {limits.ZIP_FILES} files of {in_words(limits.ZIP_BYTES)} together expected, found "
                f"{len(wanted)} of {in_words(size)}; unpack it, and give the folder of its tiles"
            )
        for one in wanted:
            place = folder / PurePosixPath(one.filename)
            place.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(one) as source, place.open("wb") as target:
                shutil.copyfileobj(source, target)
        return sorted(folder / PurePosixPath(one.filename) for one in wanted if kinds.get(one.filename))


def _stays_inside(name: str) -> bool:
    """Whether a name leads to no place outside the folder that it is unpacked into."""
    place = PurePosixPath(name.replace("\\", "/"))
    return "\\" not in name and not place.is_absolute() and ".." not in place.parts and ":" not in name


def _kind(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> str:
    """``CityGML``, ``CityJSON``, or nothing."""
    with archive.open(entry) as file:
        head = file.read(_HEAD)
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return "CityGML" if b"CityModel" in head else ""
    return "CityJSON" if _CITYJSON.search(head) else ""
