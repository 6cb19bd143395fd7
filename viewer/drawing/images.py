"""Images that stay on the GPU: what requests capture into, and what draws show later (DESIGN section 5).

An image has colour (premultiplied; alpha is coverage), depth along the axis of what it was captured as, 0 where nothing is,
and object ids; and while it is captured into, a depth buffer. Its top row is the first. Rooms of images that were dropped are
kept for others of their size, because making room takes as long as drawing into it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import CaptureError
from viewer.plan import ImageKey, Slot

__all__ = ["CapturedPixels", "Image", "Images"]

_SPARE = 4 << 20
"""Texels of dropped images that are kept for others at most."""
_TEXEL = 16
"""Bytes of a texel of an image."""
_STEP = 64
"""Images have room for sizes that are whole multiples of this, so that sizes that change a little need no new room."""


class CapturedPixels(NamedTuple):
    """What an image holds, top row first: ``color`` (h, w, 4) uint8, ``depth`` (h, w) float32, ``object_ids`` (h, w) int32."""

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    object_ids: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """An image's textures, which have room for ``room`` (width, height) texels, and what draws into them."""

    room: tuple[int, int]
    color: Any
    depth: Any
    ids: Any
    target: Any

    def release(self) -> None:
        """Free it."""
        for thing in (self.target, self.target.depth_attachment, self.color, self.depth, self.ids):
            thing.release()


class Images:
    """The images of one OpenGL context, by key."""

    def __init__(self, context: Any) -> None:  # noqa: ANN401
        self._context = context
        self._images: dict[ImageKey, tuple[tuple[int, int], Image]] = {}
        self._spare: list[Image] = []
        self._begun: dict[ImageKey, tuple[tuple[int, int], list[Any]]] = {}  # the size, and parts of a room

    def __getitem__(self, key: ImageKey) -> Image:
        """Raises KeyError for an image that nothing was captured into."""
        return self._images[key][1]

    def drop(self, key: ImageKey) -> None:
        """Forget an image; nothing where there is none."""
        for part in self._begun.pop(key, ((0, 0), ()))[1]:
            part.release()
        if key not in self._images:
            return
        self._spare.append(self._images.pop(key)[1])
        while sum(one.room[0] * one.room[1] for one in self._spare) > _SPARE:
            self._spare.pop(0).release()

    def of(self, owner: str) -> tuple[ImageKey, ...]:
        """The images that somebody has."""
        return tuple(key for key in (*self._images, *self._begun) if key.owner == owner)

    def bytes(self, owner: str) -> int:
        """What somebody's images take: colour, depth, ids and a depth buffer, of 4 bytes a texel each."""
        return sum(
            _TEXEL * image.room[0] * image.room[1] for key, (_, image) in self._images.items() if key.owner == owner
        )

    def reserve(self, key: ImageKey, size: tuple[int, int]) -> bool:
        """Make room for an image of ``size`` (width, height) that holds nothing, where there is none of that size.

        True if it is there now; a call makes a part of it, since all of it takes as long as drawing a large picture. Raises
        CaptureError where OpenGL has no images so large.
        """
        if key in self._images and self._images[key][0] == size:
            return True
        if key not in self._begun or self._begun[key][0] != size:
            self.drop(key)
        room = (-(-size[0] // _STEP) * _STEP, -(-size[1] // _STEP) * _STEP)
        image = next((one for one in self._spare if one.room == room), None)
        if image is not None:
            self._spare.remove(image)
        else:
            parts = self._begun.setdefault(key, (size, []))[1]
            image = self._room(room, parts)
            if image is None:
                return False
            parts.clear()
        self.drop(key)
        self._images[key] = (size, image)
        self._clear(image, (0, 0, *size))
        return True

    def begin(self, into: Slot, size: tuple[int, int], *, clear: bool) -> None:
        """Let what is drawn next go into a place of ``size``, on what is there or, with ``clear``, on nothing.

        Raises ValueError where the place is not within its image, CaptureError where OpenGL has no images so large.
        """
        (x, y), (width, height) = into.corner, into.size
        if not (0 <= x <= width - size[0] and 0 <= y <= height - size[1]):
            raise ValueError(f"{into.image}: a place within {into.size} expected, found {size} at {into.corner}")
        while not self.reserve(into.image, into.size):
            pass
        image = self[into.image]
        if clear:
            self._clear(image, (x, y, *size))
        image.target.use()
        image.target.viewport = (x, y, *size)
        self._context.scissor = (x, y, *size)

    def end(self) -> None:
        """End what :meth:`begin` began."""
        self._context.scissor = None

    def read(self, key: ImageKey) -> CapturedPixels:
        """What an image holds. Raises KeyError for one that nothing was captured into."""
        (width, height), image = self._images[key]
        found = []
        for attachment, (components, dtype) in enumerate(((4, "f1"), (1, "i4"), (1, "f4"))):
            data = image.target.read(
                viewport=(0, 0, width, height), components=components, attachment=attachment, dtype=dtype, alignment=1
            )
            found.append(np.frombuffer(data, dtype="u1" if dtype == "f1" else dtype).reshape(height, width, -1))
        color, ids, depth = found
        return CapturedPixels(color, depth[..., 0], ids[..., 0])

    def _room(self, room: tuple[int, int], parts: list[Any]) -> Image | None:
        """A new room, or None while ``parts`` are not all of it: one is added in each call."""
        limit = self._context.info["GL_MAX_TEXTURE_SIZE"]
        if max(room) > limit:
            raise CaptureError(f"OpenGL here has textures of at most {limit} texels a side, and an image needs {room}")
        kinds = ((4, "f1", moderngl.LINEAR), (1, "f4", moderngl.NEAREST), (1, "i4", moderngl.NEAREST))
        if len(parts) < len(kinds):
            components, dtype, smoothing = kinds[len(parts)]
            texture = self._context.texture(room, components, dtype=dtype)
            texture.filter = (smoothing, smoothing)
            texture.repeat_x = texture.repeat_y = False
            parts.append(texture)
            return None
        color, depth, ids = parts
        return Image(
            room,
            color,
            depth,
            ids,
            self._context.framebuffer([color, ids, depth], self._context.depth_renderbuffer(room)),
        )

    def _clear(self, image: Image, place: tuple[int, int, int, int]) -> None:
        image.target.clear(0.0, 0.0, 0.0, 0.0, viewport=place)
