"""The two forms of JSON that are written, one for people and one for fingerprints, and SHA-256 fingerprints of values.

And JSON that people wrote, which is not trusted: what is read of it is checked, and messages name what was expected.
"""

from __future__ import annotations

import hashlib
import json
import math
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mmi import limits
from mmi.foundation.errors import ParameterError

__all__ = [
    "canonical_json",
    "fingerprint",
    "json_number",
    "json_object",
    "read_json",
    "readable_json",
    "shown",
    "with_checksum",
]

_AT_ONCE = 1 << 20
"""Bytes that are asked for at once: memory is taken for all of them, however few there are."""


def with_checksum(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """``manifest`` with its field ``checksum``: the SHA-256 of the canonical JSON of all others, in hexadecimal."""
    others = {key: value for key, value in manifest.items() if key != "checksum"}
    return {**others, "checksum": fingerprint(others)}


def readable_json(value: Any) -> bytes:  # noqa: ANN401
    """JSON that people can read as well: sorted and indented, ending in a line break."""
    return _encoded(json.dumps(value, sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False)) + b"\n"


_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def canonical_json(value: Any) -> bytes:  # noqa: ANN401
    """The one way that this project writes JSON for hashing and storing: sorted keys, no spaces, shortest floats."""
    return _encoded(_CANONICAL.encode(value))


def _encoded(text: str) -> bytes:
    """UTF-8; what it lacks, halves of surrogate pairs, as the escapes of JSON that mean them."""
    return text.encode("utf-8", errors="backslashreplace")


def fingerprint(value: Any) -> str:  # noqa: ANN401
    """SHA-256 of the canonical JSON of ``value``, in hexadecimal."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


def read_json(path: Path, what: str) -> Any:  # noqa: ANN401
    """The JSON of a file in UTF-8, up to 256 MB of it; ``what`` is what was expected there, for messages ("a walk").

    Raises ParameterError.
    """
    try:
        with Path(path).open("rb") as file:
            data = bytearray()
            while len(data) <= limits.JSON_BYTES and (more := file.read(_AT_ONCE)):
                data += more
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise ParameterError(f"{path}: {what}'s JSON file expected, found: {reason}") from error
    if len(data) > limits.JSON_BYTES:
        raise ParameterError(f"{path}: {what}'s JSON of up to {limits.JSON_BYTES} bytes expected, found more")
    try:
        return json.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path}: {what}'s JSON in UTF-8 expected, found byte {error.start} is none") from error
    except (ValueError, RecursionError) as error:
        raise ParameterError(f"{path}: {what}'s JSON expected, found damaged data ({error})") from error


def json_object(
    value: object, where: str, *, required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict[str, Any]:
    """``value`` if it is a JSON object with these keys and no others. Raises ParameterError, which says ``where``."""
    if not isinstance(value, dict):
        raise ParameterError(f"{where}: a JSON object expected, found {shown(value)}")
    for key in required:
        if key not in value:
            raise ParameterError(f'{where}: the key "{key}" expected, found {shown(sorted(value))}')
    for key in value:
        if key not in (*required, *optional):
            raise ParameterError(f"{where}: the keys {', '.join((*required, *optional))} expected, found {shown(key)}")
    return value


def json_number(value: object, where: str, *, most: float) -> float:
    """``value`` as a float if it is a number (true and false are none) from -``most`` to ``most``. Raises ParameterError."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if abs(number) <= most:
            return number
        raise ParameterError(f"{where}: a number up to {most:.0f} expected, found {shown(value)}")
    raise ParameterError(f"{where}: a number expected, found {shown(value)}")


def shown(value: object) -> str:
    """``value`` for a message, however large it is."""
    return reprlib.repr(value)
