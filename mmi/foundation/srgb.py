"""Conversion between sRGB bytes, which textures and vertex colours are here, and linear light, which glTF's vertex colours and
EXR hold.

Source: IEC 61966-2-1.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

__all__ = ["linear_from_srgb", "png_bytes", "srgb_from_linear"]


def linear_from_srgb(colors: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Linear light in [0, 1] of sRGB bytes, any shape."""
    value = colors / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The nearest sRGB bytes to linear light in [0, 1], any shape."""
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * srgb).astype(np.uint8)


def png_bytes(pixels: NDArray[np.uint8], *, quick: bool = False) -> bytes:
    """Pixels (h, w, 3 or 4) as PNG; the same pixels give the same bytes. ``quick`` makes it faster and larger."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="png", compress_level=1 if quick else -1)
    return buffer.getvalue()
