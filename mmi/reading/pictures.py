"""Encoded pictures of 3D models become textures: opaque sRGB bytes, each picture once however often it is referred to."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from PIL import Image

from mmi import limits
from mmi.city.model import Texture
from mmi.foundation.errors import CityError
from mmi.foundation.whole_files import in_words, real_path
from mmi.reading.names import UniqueNames, readable_name
from mmi.reading.report import Ledger

__all__ = ["PictureShelf", "contained_path", "file_beside", "picture_bytes", "texture_from_bytes"]

_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "TGA", "GIF")


def picture_bytes(file: Path, name: str, ledger: Ledger) -> bytes | None:
    """The encoded picture ``name`` in a file; None, and a note, where it is too large to be one."""
    if file.stat().st_size > limits.PICTURE_BYTES:
        ledger.note("left out", f"picture: more than {in_words(limits.PICTURE_BYTES)}", name)
        return None
    return file.read_bytes()


def texture_from_bytes(
    data: bytes, name: str, ledger: Ledger, *, alpha: bool, room: float = math.inf
) -> Texture | None:
    """The encoded picture as a texture called ``name``; None, and a note, where it cannot be decoded.

    With ``alpha``, what is transparent shows the mean of the opaque colours; else the alpha channel is ignored. ``room``
    pixels are left for it.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data), formats=_FORMATS) as picture:
                if picture.width * picture.height > limits.PICTURE_PIXELS:
                    ledger.note("left out", f"picture: more than {limits.PICTURE_PIXELS} pixels", name)
                    return None
                if picture.width * picture.height > room:
                    ledger.note("left out", f"picture: beyond {limits.PICTURES_PIXELS} pixels in all", name)
                    return None
                translucent = alpha and picture.has_transparency_data
                pixels = np.asarray(picture.convert("RGBA" if translucent else "RGB"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # whatever PIL throws
        ledger.note("left out", "picture: it cannot be decoded", name)
        return None
    if pixels.shape[2] == 4:
        weight = pixels[..., 3:] / 255.0
        if (weight < 1.0).any():
            ledger.note("noted", "picture with alpha drawn opaque, on its mean colour", name)
        total = float(weight.sum())
        solid = pixels[..., :3].astype(np.float64)
        mean = (solid * weight).sum(axis=(0, 1)) / total if total > 0.0 else solid.mean(axis=(0, 1))
        pixels = np.rint(solid * weight + mean * (1.0 - weight)).astype(np.uint8)
    return Texture(name, pixels)


def contained_path(folder: Path, reference: str, file: Path) -> Path:
    """The file in or below ``folder`` that ``reference`` names.

    Raises:
        CityError: it lies outside; ``file`` is who refers to it.
    """
    path = folder
    # A backslash parts folders in most references, but it may be the second byte of a character in a file's name.
    for text in (reference, reference.replace("\\", "/")):
        path = real_path(folder / text)
        if not path.is_relative_to(real_path(folder)):
            raise CityError(f"{file}: refers to {reference!r}; expected files in its own folder or below")
        if path.exists():
            break
    return path


def file_beside(folder: Path, reference: str, ledger: Ledger, *, also: Sequence[str] = ()) -> Path | None:
    """The file in or below ``folder`` that ``reference`` means, None where there is none; nothing else is looked at.

    Exporters write where a picture was on their machine: an absolute path, one that climbs out of the folder or has a drive
    in it, in quotes, percent-encoded, or in another case. What is not there as it is written, nor in one of the folders
    ``also``, is looked for by the end of its path, the longest first, at last by its name alone; where that finds it, the
    ledger says so.
    """
    bare = reference.strip().strip("\"'")
    forms = dict.fromkeys((reference, bare, bare.replace("\\", "/"), unquote(bare.replace("\\", "/"))))
    inside = real_path(folder)
    for form, where in product(forms, ("", *also)):
        with suppress(OSError, ValueError):  # no file can have such a name
            file = real_path(folder / where / form)
            if file.is_relative_to(inside) and file.is_file():
                return file
    for form in forms if "://" not in bare or bare.startswith("file:") else ():  # nothing stands for what is elsewhere
        steps = [step for step in form.split("/") if step not in ("", ".")]
        for start, where in product(range(len(steps)), ("", *also)):
            found = _whatever_the_case(folder / where, steps[start:])
            if found is not None and real_path(found).is_relative_to(inside):
                name = readable_name(reference.encode("utf-8", "surrogateescape"))
                ledger.note("repaired", "file found beside the model by its name", name)
                return found
    return None


def _whatever_the_case(folder: Path, steps: list[str]) -> Path | None:
    """The file below ``folder`` to which ``steps`` lead, as they are written or else in another case."""
    place = folder
    for step in steps:
        if step == "..":
            return None
        with suppress(OSError):
            inside = sorted(one.name for one in place.iterdir())
            same = [name for name in inside if name == step] or [
                name for name in inside if name.casefold() == step.casefold()
            ]
            if same:
                place = place / same[0]
                continue
        return None
    return place if place.is_file() else None


class PictureShelf:
    """The textures of a model while it is read: equal pictures have one place.

    A name that another picture has already gets a number.
    """

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._places: dict[tuple[bytes, bool], int | None] = {}
        self._names = UniqueNames()
        self._textures: list[Texture] = []
        self._pixels = 0

    def place(self, data: bytes, name: str, *, alpha: bool) -> int | None:
        """Index of the texture of the encoded picture ``data``; None where it cannot be decoded (noted)."""
        key = (data, alpha)
        if key not in self._places:
            unique = self._names.free(name)
            room = limits.PICTURES_PIXELS - self._pixels
            texture = texture_from_bytes(data, unique, self._ledger, alpha=alpha, room=room)
            self._places[key] = None if texture is None else len(self._textures)
            if texture is not None:
                self._names.take(unique)
                self._textures.append(texture)
                self._pixels += texture.image.shape[0] * texture.image.shape[1]
        return self._places[key]

    def place_file(self, file: Path, name: str, *, alpha: bool) -> int | None:
        """The same of a picture in a file; None where it is too large, too (noted)."""
        data = picture_bytes(file, name, self._ledger)
        return None if data is None else self.place(data, name, alpha=alpha)

    def textures(self) -> tuple[Texture, ...]:
        """All of them, in the order of their places."""
        return tuple(self._textures)
