"""Texts in OpenStreetMap's PBF at which osmium would read beyond its memory are refused, however their block is packed."""

import zlib

import osmium
import pytest
from city_files import OsmFile

from mmi.foundation.errors import CityError
from mmi.reading.maps.osm_pbf import refuse_zero_bytes
from mmi.reading.read_city import read_city


def written(tmp_path, options):
    """A house and a street as PBF of osmium's own."""
    osm = OsmFile()
    osm.box(1, 0.0, 20.0, 20.0, 40.0, building="yes", height="9", name="")
    osm.way(2, [(-30.0, 5.0), (80.0, 8.0)], highway="residential")
    path = tmp_path / "x.osm.pbf"
    with osmium.SimpleWriter(osmium.io.File(str(path), options), overwrite=True) as writer:
        for one in osmium.FileProcessor(str(osm.write(tmp_path / "x.osm"))):
            writer.add(one)
    return path


def field(number, data):
    """A field of bytes of a message; all here are shorter than 16 kB."""
    size = len(data)
    return bytes([number << 3 | 2, size & 0x7F | 0x80, size >> 7]) + data


def packed(path):
    """The file, whose blocks are as they are, with blocks that zlib packed; and with a second table behind each."""
    data, found, at = path.read_bytes(), b"", 0
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        head = data[at + 4 : at + 4 + size]
        kind = b"OSMHeader" if b"OSMHeader" in head else b"OSMData"
        start = at + 4 + size
        end = data.find(b"OSMData", start)
        end = len(data) if end < 0 else end - 6
        blob = data[start:end]
        raw = blob[next(i for i in range(1, len(blob)) if blob[i] < 0x80) + 1 :]
        blob = field(3, zlib.compress(raw)) + b"\x10" + bytes([len(raw) & 0x7F | 0x80, len(raw) >> 7])
        header = field(1, kind) + b"\x18" + bytes([len(blob) & 0x7F | 0x80, len(blob) >> 7])
        found += len(header).to_bytes(4, "big") + header + blob
        at = end
    return found


@pytest.mark.parametrize("options", ["pbf", "pbf,pbf_compression=none", "pbf,pbf_dense_nodes=false"])
def test_what_osmium_writes_is_read(tmp_path, options):
    path = written(tmp_path, options)
    refuse_zero_bytes(path)
    city, _ = read_city(path)
    assert [one.id for one in city.objects] == ["way/1"]


def test_a_zero_byte_in_a_text_is_refused(tmp_path):
    """osmium takes what follows for other tags, and what follows the last of them too."""
    path = written(tmp_path, "pbf,pbf_compression=none")
    path.write_bytes(packed(path))
    assert len(read_city(path)[0].objects) == 1
    whole = written(tmp_path, "pbf,pbf_compression=none").read_bytes()
    for text in (b"building", b"residential", b"height"):
        path.write_bytes(whole.replace(text, text[:4] + b"\0" + text[5:]))
        with pytest.raises(CityError, match="found: a zero byte in the text '"):
            read_city(path)
        path.write_bytes(packed(path))
        with pytest.raises(CityError, match="found: a zero byte in the text '"):
            read_city(path)


def test_blocks_that_cannot_be_looked_through_are_refused(tmp_path):
    with pytest.raises(CityError, match="not packed by zlib"):
        read_city(written(tmp_path, "pbf,pbf_compression=lz4"))


def test_damage_is_told_in_one_line(tmp_path):
    """Wherever the file ends, and whatever a byte says."""
    path = written(tmp_path, "pbf,pbf_compression=none")
    whole = path.read_bytes()
    for place in range(len(whole)):
        for data in (whole[:place], whole[:place] + b"\xff" + whole[place + 1 :]):
            path.write_bytes(data)
            try:
                refuse_zero_bytes(path)
            except ValueError as error:
                assert "\n" not in str(error)
