"""The container against bytes that are put together by hand, as the specification says."""

from __future__ import annotations

import json
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

import mmi.gltf.container
from mmi.gltf.container import BIN, JSON, glb_chunks, glb_pieces, glb_version, is_glb


def by_hand(*chunks, version=2, size=None):
    body = b"".join(struct.pack("<II", len(data), kind) + data for kind, data in chunks)
    return struct.pack("<4sII", b"glTF", version, 12 + len(body) if size is None else size) + body


def test_pieces_make_the_file_of_the_specification():
    document = {"asset": {"version": "2.0"}, "nodes": [], "name": "ä"}
    text = '{"asset":{"version":"2.0"},"name":"ä"}'.encode()
    text += b" " * (-len(text) % 4)
    assert b"".join(glb_pieces(document, [b"1234", b"56780000"])) == by_hand((JSON, text), (BIN, b"123456780000"))
    assert b"".join(glb_pieces(document, [])) == by_hand((JSON, text))
    (_, plain) = glb_pieces({"b": 1, "a": "ä"}, [], sort_keys=True, ascii_only=True)
    assert plain.rstrip() == rb'{"a":"\u00e4","b":1}'


@given(st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=9), max_size=4), st.integers(0, 5))
def test_what_is_put_together_comes_apart(document, words):
    blobs = [bytes([i] * 4 * i) for i in range(words)]
    data = b"".join(glb_pieces(document, blobs))
    assert is_glb(data)
    assert glb_version(data) == 2
    (_, text), *rest = glb_chunks(data)
    assert json.loads(text) == document
    assert rest == ([(BIN, b"".join(blobs))] if any(blobs) else [])


def test_a_file_past_the_header_is_refused(monkeypatch):
    size = sum(map(len, glb_pieces({"a": 1}, [b"1234"])))
    monkeypatch.setattr(mmi.gltf.container, "_MOST_BYTES", size)
    assert glb_pieces({"a": 1}, [b"1234"])
    monkeypatch.setattr(mmi.gltf.container, "_MOST_BYTES", size - 1)
    with pytest.raises(OverflowError, match=f"at most {size - 1} bytes expected, found {size}"):
        glb_pieces({"a": 1}, [b"1234"])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"glTF", "a header of 20 bytes expected, found 4"),
        (b"PK\x03\x04" * 9, r"starts with b'PK"),
        (by_hand((JSON, b"{}  "), version=1), "version 2 expected, found version 1"),
        (by_hand((JSON, b"{}  "), size=99), "of 99 bytes expected, found 24: the file is cut off"),
        (
            by_hand((JSON, b"{}  "))[:12] + struct.pack("<II", 8, JSON) + b"{}  ",
            "a chunk of 8 bytes at byte 12 does not",
        ),
        (by_hand((BIN, b"1234")), "a JSON chunk expected, found none"),
    ],
)
def test_other_files_are_refused(data, message):
    with pytest.raises(ValueError, match=message):
        glb_chunks(data)


def test_chunks_of_other_kinds_are_given_out_too():
    chunks = [(JSON, b"{}  "), (7, b"abcd"), (BIN, b"")]
    assert glb_chunks(by_hand(*chunks) + b"behind it") == chunks
