"""Mutators: what is done to a seed to get an input that nobody wrote, by a random generator that can be seeded again.

Each takes bytes and gives other bytes. Bytes and chunks of any file; numbers of text; values of JSON; elements and attributes
of XML; and values inside of containers, which are closed again so that what follows them still fits: glTF's chunks, PBF's
compressed blobs, SQLite's rows.
"""

from __future__ import annotations

import copy
import gzip
import json
import re
import sqlite3
import struct
import zlib
from collections.abc import Callable
from random import Random
from typing import Any
from xml.etree import ElementTree

Mutator = Callable[[bytes, Random], bytes]

MOST_BYTES = 4_000_000
"""What grows beyond this is cut: what is looked for is not the machine's limit."""
WORDS = (b"", b"0", b"-1", b"nan", b"inf", b"-inf", b"1e308", b"1e-308", b"1e999", b"2147483648", b"9223372036854775808",
    b"4294967295", b"1e9", b"-1e9", b"91", b"181", b"3.7e5", b"0x10", b"1,5", b"true", b"None", b"../x", b"/etc/hostname",
    b"\xc3\x28", b"\xed\xa0\x80", b"\x00", "é".encode(), b"EPSG:4326", b"1_000", b"--5")  # fmt: skip
VALUES = (None, True, False, 0, -1, 1, 2, 10**6, 2**31, 2**63, 10**400, -(2**31), 0.5, -0.0, 1e308, -1e308, 5e-324, 1e9, -1e5,
    float("nan"), float("inf"), "", "nan", "x", "../x", "/etc/hostname", "1e400", "\ud800", [], {}, [[]], [0], {"": None},
    "a" * 300)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_TAG = re.compile(rb"<[^<>]*>")
_NO_XML = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
_ATTRIBUTE = re.compile(rb"\"[^\"<>]*\"")


# ------------------------------------------------------------------------------------------------- any file at all


def changed_bytes(data: bytes, rng: Random) -> bytes:
    """One bit, one byte, or a number of two to eight bytes as binary formats have them."""
    if not data:
        return rng.randbytes(4)
    found, at = bytearray(data), rng.randrange(len(data))
    kind = rng.randrange(4)
    if kind == 0:
        found[at] ^= 1 << rng.randrange(8)
    elif kind == 1:
        found[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    elif kind == 2:
        width = rng.choice((2, 4, 8))
        number = rng.choice((0, 1, 2 ** (8 * width - 1), 2 ** (8 * width) - 1, 2 ** (8 * width - 1) - 1, 65536))
        found[at : at + width] = (number % 2 ** (8 * width)).to_bytes(width, rng.choice(("little", "big")))
    else:
        number = rng.choice((float("nan"), float("inf"), -1.0, 1e30, 0.0))
        packed = struct.pack(rng.choice(("<", ">")) + rng.choice("fd"), number)
        found[at : at + len(packed)] = packed
    return bytes(found)


def changed_chunks(data: bytes, rng: Random) -> bytes:
    """A stretch of the file is cut out, doubled, moved, filled or repeated; or the file ends early."""
    if len(data) < 4:
        return data + rng.randbytes(8)
    start = rng.randrange(len(data))
    size = min(1 << rng.randrange(1 + len(data).bit_length()), len(data) - start)
    piece, kind = data[start : start + size], rng.randrange(6)
    if kind == 0:
        return data[:start] + data[start + size :]
    if kind == 1:
        return data[:start] + piece + data[start:]
    if kind == 2:
        rest = data[:start] + data[start + size :]
        at = rng.randrange(len(rest) + 1)
        return rest[:at] + piece + rest[at:]
    if kind == 3:
        return data[:start] + bytes([rng.choice((0, 0xFF, 0x20, 0x41))]) * size + data[start + size :]
    if kind == 4:
        return (data[:start] + piece * rng.choice((3, 20, 300)) + data[start:])[:MOST_BYTES]
    return data[:start]


def changed_lines(data: bytes, rng: Random) -> bytes:
    """Lines are left out, doubled, swapped or cut."""
    lines = data.split(b"\n")
    i, j, kind = rng.randrange(len(lines)), rng.randrange(len(lines)), rng.randrange(4)
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(j, lines[i])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = lines[i][: rng.randrange(len(lines[i]) + 1)]
    return b"\n".join(lines)


def changed_numbers(data: bytes, rng: Random) -> bytes:
    """A number of a text becomes another one, or no number."""
    found = list(_NUMBER.finditer(data))
    if not found:
        return changed_bytes(data, rng)
    one = rng.choice(found)
    word = rng.choice(WORDS)
    if rng.random() < 0.4:
        word = rng.choice(found).group()
    elif rng.random() < 0.3:
        word = one.group() + rng.choice((b"0", b"000", b"e5", b".5", b"e-9"))
    return data[: one.start()] + word + data[one.end() :]


# ------------------------------------------------------------------------------------------------------------- XML


def changed_xml(data: bytes, rng: Random) -> bytes:
    """An attribute's value, or a whole element up to another tag, is changed, left out, doubled or moved."""
    if rng.random() < 0.5:
        found = list(_ATTRIBUTE.finditer(data))
        if found:
            one = rng.choice(found)
            word = rng.choice(found).group() if rng.random() < 0.5 else b'"' + rng.choice(WORDS) + b'"'
            return data[: one.start()] + word + data[one.end() :]
    tags = list(_TAG.finditer(data))
    if len(tags) < 3:
        return changed_chunks(data, rng)
    first = rng.randrange(len(tags) - 1)
    last = min(first + rng.choice((0, 0, 1, 2, 4, 16)), len(tags) - 1)
    start, end = tags[first].start(), tags[last].end()
    piece, kind = data[start:end], rng.randrange(4)
    if kind == 0:
        return data[:start] + data[end:]
    if kind == 1:
        return data[:end] + piece * rng.choice((1, 1, 50)) + data[end:]
    at = rng.choice(tags).start()
    if kind == 2:
        return data[:at] + piece + data[at:]
    return data[:start] + rng.choice((b"<a/>", b"&lt;", b"&x;", b"<!--", b"<![CDATA[", b"text")) + data[end:]


def changed_elements(data: bytes, rng: Random) -> bytes:
    """An element, a text or an attribute of well-formed XML is changed, left out, doubled, moved or swapped; it stays so."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError):
        return changed_chunks(data, rng)
    holders = [one for one in root.iter() if len(one)] or [root]
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        # The name of an element first, so that hundreds of corners do not hide the few elements at the top.
        names = sorted({one.tag for one in root.iter()})
        name = rng.choice(names)
        one, kind = rng.choice(list(root.iter(name))), rng.randrange(7)
        holder = rng.choice(holders)
        if kind == 0 and len(one):
            one.remove(rng.choice(list(one)))
        elif kind == 1 and len(one):
            one.insert(rng.randrange(len(one) + 1), copy.deepcopy(rng.choice(list(one))))
        elif kind == 2 and holder not in one.iter():
            holder.insert(rng.randrange(len(holder) + 1), copy.deepcopy(one))
        elif kind == 3 and one.text and one.text.strip():
            one.text = changed_numbers(one.text.encode("utf-8", "replace"), rng).decode("utf-8", "replace")
        elif kind == 4:
            one.tag = rng.choice(names)
        elif one.attrib:
            key = rng.choice(list(one.attrib))
            others = [other.attrib[key] for other in root.iter() if key in other.attrib]
            value = rng.choice((*map(_word, WORDS), *others))
            if rng.random() < 0.5:
                value = changed_numbers(one.attrib[key].encode("utf-8", "replace"), rng).decode("utf-8", "replace")
            one.attrib[key] = value
            if rng.random() < 0.2:
                del one.attrib[key]
    return _NO_XML.sub(b"", ElementTree.tostring(root))[:MOST_BYTES]


def _word(word: bytes) -> str:
    return word.decode("utf-8", "replace")


# ------------------------------------------------------------------------------------------------------------ JSON


def _ways(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [at]
    if isinstance(value, dict):
        for key, one in value.items():
            found += _ways(one, (*at, key))
    elif isinstance(value, list):
        for key, one in enumerate(value):
            found += _ways(one, (*at, key))
    return found


def _at(value: Any, way: tuple[Any, ...]) -> Any:
    for key in way:
        value = value[key]
    return value


def changed_value(document: Any, rng: Random) -> Any:
    """A JSON document (which is changed) with another value somewhere, a list or an object emptied, doubled or swapped."""
    ways = [way for way in _ways(document) if way]
    if not ways:
        return rng.choice(VALUES)
    # The length of a way first, so that thousands of numbers do not hide the few values at the top.
    depth = rng.choice(sorted({len(way) for way in ways}))
    way = rng.choice([one for one in ways if len(one) == depth])
    holder, key = _at(document, way[:-1]), way[-1]
    value, kind = holder[key], rng.randrange(9)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(value, list):
        holder[key] = value * 2
    elif kind == 1 and isinstance(value, int | float):
        holder[key] = rng.choice((-value, value * 1000 if abs(value) < 1e300 else 0, value + 1, value - 1, str(value)))
    elif kind == 2:
        holder[key] = type(value)() if isinstance(value, list | dict | str) else 0
    elif kind in (3, 4):
        other = rng.choice([one for one in ways if len(one) == depth])
        if other[: len(way)] != way and way[: len(other)] != other:
            theirs = _at(document, other[:-1])
            holder[key], theirs[other[-1]] = theirs[other[-1]], value
    elif kind == 5 and isinstance(holder, list):
        holder.insert(key, value)
    elif kind == 5 and isinstance(holder, dict):
        holder[rng.choice(("x", "", "../x", "\ud800", *map(str, list(holder)[:5])))] = value
    elif kind == 6 and isinstance(value, list) and value:
        holder[key] = value[: rng.randrange(len(value))]
    else:
        holder[key] = rng.choice(VALUES)
    return document


def _encoded(document: Any) -> bytes:
    return json.dumps(document).encode()[:MOST_BYTES]


def changed_json(data: bytes, rng: Random) -> bytes:
    """One to three values of a JSON file; a sequence of several documents has one to a line."""
    lines = data.splitlines() if data.count(b"\n{") else [data]
    i = rng.randrange(len(lines))
    try:
        document = json.loads(lines[i])
    except (ValueError, RecursionError):
        return changed_chunks(data, rng)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        document = changed_value(document, rng)
    lines[i] = _encoded(document)
    return b"\n".join(lines)


# ------------------------------------------------------------------------------------------------------ containers


def changed_glb(data: bytes, rng: Random) -> bytes:
    """Values of a binary glTF's JSON chunk, or bytes of its binary one, with sizes that fit again."""
    size = int.from_bytes(data[12:16], "little")
    document, body = data[20 : 20 + size], data[28 + size :]
    if rng.random() < 0.7:
        document = changed_json(document, rng)
        document += b" " * (-len(document) % 4)
    else:
        body = rng.choice((changed_bytes, changed_bytes, changed_chunks))(body, rng)
        body += b"\0" * (-len(body) % 4)
    chunks = struct.pack("<II", len(document), 0x4E4F534A) + document
    if body:
        chunks += struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _varint(number: int) -> bytes:
    found = bytearray()
    while number >= 0x80:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*found, number])


def _fields(data: bytes) -> dict[int, Any]:
    """The fields of a protocol buffer message of numbers and byte strings, the last of each."""
    found: dict[int, Any] = {}
    at = 0

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(data):
        key = number()
        value: Any = number()
        if key & 7 == 2:
            value, at = data[at : at + value], at + value
        found[key >> 3] = value
    return found


def changed_pbf(data: bytes, rng: Random) -> bytes:
    """Bytes inside of one of the compressed blobs, which are compressed again; its true size, or another, is stated."""
    blobs, at = [], 0
    while at + 4 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        header = _fields(data[at + 4 : at + 4 + size])
        start = at + 4 + size
        blobs.append((header[1], data[start : start + header[3]]))
        at = start + header[3]
    i = rng.randrange(len(blobs))
    pieces = []
    for place, (kind, blob) in enumerate(blobs):
        if place == i:
            fields = _fields(blob)
            raw = fields[1] if 1 in fields else zlib.decompress(fields[3])
            for _ in range(rng.choice((1, 1, 2, 4))):
                raw = rng.choice((changed_bytes, changed_bytes, changed_chunks))(raw, rng)
            stated = len(raw) if rng.random() < 0.9 else rng.choice((0, 1, 2**31 - 1, 32 << 20))
            packed = zlib.compress(raw)
            blob = b"\x10" + _varint(stated) + b"\x1a" + _varint(len(packed)) + packed
        header = b"\x0a" + _varint(len(kind)) + kind + b"\x18" + _varint(len(blob))
        pieces += [len(header).to_bytes(4, "big"), header, blob]
    return b"".join(pieces)


def changed_gzip(data: bytes, rng: Random) -> bytes:
    """XML inside of gzip."""
    return gzip.compress(rng.choice((changed_xml, changed_elements))(gzip.decompress(data), rng), mtime=0)


def changed_sqlite(data: bytes, rng: Random) -> bytes:
    """A value of a row of any table, the catalogue of a GeoPackage too; or a whole row or table is left out."""
    base = sqlite3.connect(":memory:")
    base.deserialize(data)
    try:
        base.execute("PRAGMA writable_schema=ON")
        tables = [name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        for _ in range(rng.choice((1, 1, 2))):
            table = rng.choice(tables)
            columns = [row[1] for row in base.execute(f'PRAGMA table_info("{table}")')]
            (rows,) = base.execute(f'SELECT count(*) FROM "{table}"').fetchone()
            column, row = rng.choice(columns), rng.randrange(max(rows, 1))
            where = f'WHERE rowid = (SELECT rowid FROM "{table}" LIMIT 1 OFFSET {row})'
            kind = rng.randrange(8)
            if kind == 0:
                base.execute(f'DELETE FROM "{table}" {where}')
            elif kind == 1:
                base.execute(f'DROP TABLE "{table}"')
                tables.remove(table)
            else:
                (value,) = base.execute(f'SELECT "{column}" FROM "{table}" {where}').fetchone() or (None,)
                if isinstance(value, bytes) and rng.random() < 0.9:
                    value = rng.choice((changed_bytes, changed_bytes, changed_chunks))(value, rng)
                else:
                    value = rng.choice(
                        (None, 0, -1, 2**62, 1e308, float("inf"), "", "x", "nan", b"\x00", b"GP", 4326, 3857)
                    )
                base.execute(f'UPDATE "{table}" SET "{column}" = ? {where}', (value,))
        base.commit()
        return base.serialize()
    except sqlite3.Error:  # triggers, checks: try the bytes
        return changed_bytes(data, rng)
    finally:
        base.close()
