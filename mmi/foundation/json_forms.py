"""The two forms of JSON that are written, one for people and one for fingerprints, and SHA-256 fingerprints of values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

__all__ = ["canonical_json", "fingerprint", "readable_json", "with_checksum"]


def with_checksum(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """``manifest`` with its field ``checksum``: the SHA-256 of the canonical JSON of all others, in hexadecimal."""
    others = {key: value for key, value in manifest.items() if key != "checksum"}
    return {**others, "checksum": fingerprint(others)}


def readable_json(value: Any) -> bytes:  # noqa: ANN401
    """JSON that people can read as well: sorted and indented, ending in a line break."""
    return json.dumps(value, sort_keys=True, indent=1, allow_nan=False, ensure_ascii=False).encode() + b"\n"


_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def canonical_json(value: Any) -> bytes:  # noqa: ANN401
    """The one way that this project writes JSON for hashing and storing: sorted keys, no spaces, shortest floats."""
    return _CANONICAL.encode(value).encode()


def fingerprint(value: Any) -> str:  # noqa: ANN401
    """SHA-256 of the canonical JSON of ``value``, in hexadecimal."""
    return hashlib.sha256(canonical_json(value)).hexdigest()
