"""Images in memory: those needed last stay, and a thread brings in those of the points around, near to far (section 5)."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import fields

from viewer.layered.layered_image import LayeredImage
from viewer.placed.folder import PlacedFolder

__all__ = ["LoadedImages"]


class LoadedImages:
    """Images of a folder, at most ``most`` bytes of them besides the one that is needed."""

    def __init__(self, folder: PlacedFolder, *, most: int) -> None:
        self._folder, self._most = folder, most
        self._lock = threading.Lock()
        self._images: OrderedDict[int, LayeredImage] = OrderedDict()
        self._coming: dict[int, Future[LayeredImage]] = {}
        self._thread = ThreadPoolExecutor(1, "images")
        self.waited = 0
        """How many images were waited for, because they had not been brought in."""

    def get(self, number: int) -> LayeredImage:
        """An image, which is waited for where it is not there. Raises DatasetError where its file is missing or damaged."""
        with self._lock:
            if number in self._images:
                self._images.move_to_end(number)
                return self._images[number]
            coming = self._coming.get(number)
            self.waited += 1
        if coming is not None and coming.cancel():  # it waits behind others
            coming = None
        return self._bring(number) if coming is None else coming.result()

    def want(self, numbers: Sequence[int]) -> None:
        """Bring in images ahead of their need, in this order; what was wanted before and has not begun is not any more."""
        with self._lock:
            for number, coming in list(self._coming.items()):
                if number not in numbers and coming.cancel():
                    del self._coming[number]
            for number in numbers:
                if number not in self._images and number not in self._coming:
                    self._coming[number] = self._thread.submit(self._bring, number)

    @property
    def bytes(self) -> int:
        """What the images in memory take."""
        with self._lock:
            return sum(_bytes(image) for image in self._images.values())

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(cancel_futures=True)

    def _bring(self, number: int) -> LayeredImage:
        try:
            image = self._folder.image(number)
        finally:
            with self._lock:
                self._coming.pop(number, None)
        with self._lock:
            self._images[number] = image
            self._images.move_to_end(number)
            held = sum(_bytes(one) for one in self._images.values())
            while held > self._most and len(self._images) > 1:
                _, dropped = self._images.popitem(last=False)
                held -= _bytes(dropped)
        return image


def _bytes(image: LayeredImage) -> int:
    return sum(getattr(image, one.name).nbytes for one in fields(image) if one.name != "view")
