"""The corpus: small cities, walks and datasets, written by this project's own writers and those of the tests."""

from __future__ import annotations

import io
import json
import math
import os
import shutil
import struct
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from cities import crossroads
from city_files import OsmFile, degrees, geojson
from fuzz.datasets import resealed
from fuzz.pool import Seeds, fork
from fuzz.programs import BUILD
from model_cities import BOX_TRIANGLES, QUADS, box_corners, chequers, model_city
from moving import movers_of
from PIL import Image
from shapely.geometry import LineString, box

from mmi.building.dataset import build_dataset
from mmi.city.model import City
from mmi.dataset.glb import glb_bytes, read_glb
from mmi.foundation.camera import Camera
from mmi.foundation.srgb import png_bytes
from mmi.movers.movers_file import write_movers
from mmi.planning.parameters import BuildParameters
from mmi.programs.build_impostors import build_impostors
from mmi.walks.walk import Keyframe, Pose, Walk, write_walk
from mmi.writing.cityjson_writer import write_cityjson
from mmi.writing.gltf_writer import write_glb

_NET = """<?xml version="1.0"?>
<net version="1.9" xmlns:xsi="x" xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/net_file.xsd">
<location netOffset="0,0" convBoundary="-20,0,120,100" projParameter="!"/>
<type id="highway.residential" priority="3" allow="pedestrian passenger"/>
<edge id="e" from="a" to="b" type="highway.residential" name="Elm Street">
  <lane id="e_0" index="0" speed="13" allow="pedestrian" shape="-20,-4.8 98,-4.8"/>
  <lane id="e_1" index="1" disallow="tram" shape="-20,-1.6 98,-1.6"/>
</edge>
<edge id="-e" from="b" to="a" type="highway.residential"><lane id="-e_0" index="0" width="6.4" shape="98,3.2 -20,3.2"/></edge>
<edge id="one" from="b" to="c"><lane id="one_0" index="0" shape="100,2 100,50 100,98"/></edge>
<junction id="a" type="priority" x="-20" y="0" shape=""/><junction id="b" type="priority" x="100" y="0"/>
<junction id="c" type="priority" x="100" y="100"/>
</net>"""
_BOXES = ((0.0, 20.0, 20.0, 40.0), (30.0, 20.0, 50.0, 35.0), (0.0, -40.0, 20.0, -20.0))


def write_seeds(folder: Path, names: list[str]) -> None:
    """Write the seeds of these formats, a folder each. This starts threads of libraries: call it in a child."""
    written: dict[Callable[[Path], None], Path] = {}
    for name in names:
        inside, write = folder / name, _WRITERS[name.removeprefix("sealed-")]
        if write in written:
            shutil.copytree(written[write], inside)
        else:
            inside.mkdir(parents=True)
            write(inside)
            written[write] = inside


def read_seeds(names: list[str]) -> Seeds:
    """The seeds of these formats, written by a child that is gone then."""
    with tempfile.TemporaryDirectory() as place:
        child = fork()
        if child == 0:
            status = 1
            try:
                warnings.simplefilter("ignore")
                write_seeds(Path(place), names)
                status = 0
            except BaseException:
                import traceback

                traceback.print_exc()
            finally:
                os._exit(status)
        _, status = os.waitpid(child, 0)
        if status:
            raise RuntimeError(f"the seeds of {', '.join(names)} could not be written")
        return {
            name: {
                path.relative_to(Path(place) / name).as_posix(): path.read_bytes()
                for path in sorted((Path(place) / name).rglob("*"))
                if path.is_file()
            }
            for name in names
        }


# ------------------------------------------------------------------------------------------------------------ maps


def _osm_file() -> OsmFile:
    osm = OsmFile()
    for number, corners in enumerate(_BOXES, 1):
        osm.box(number, *corners, building="yes", height=str(6 + 3 * number), building__levels="3")
    osm.way(8, [(2.0, 42.0), (30.0, 42.0), (30.0, 60.0), (2.0, 60.0), (2.0, 42.0)])
    osm.way(9, [(10.0, 48.0), (20.0, 48.0), (20.0, 54.0), (10.0, 54.0), (10.0, 48.0)])
    osm.relation(5, [(8, "outer"), (9, "inner")], type="multipolygon", building="yes", height="12 ft")
    osm.way(20, [(-30.0, 5.0), (25.0, 5.0), (80.0, 8.0)], highway="residential", name="Élm <Street>", width="7")
    osm.way(21, [(25.0, 5.0), (25.0, 80.0)], highway="footway", access="no", foot="yes")
    return osm


def _osm(folder: Path) -> None:
    _osm_file().write(folder / "x.osm")


def _osm_gz(folder: Path) -> None:
    import gzip

    path = _osm_file().write(folder / "x.osm")
    (folder / "x.osm.gz").write_bytes(gzip.compress(path.read_bytes(), mtime=0))
    path.unlink()


def _pbf(folder: Path) -> None:
    import osmium

    path = _osm_file().write(folder / "x.osm")
    with osmium.SimpleWriter(str(folder / "x.osm.pbf")) as writer:
        for one in osmium.FileProcessor(str(path)):
            writer.add(one)
    path.unlink()


def _houses(folder: Path, name: str) -> None:
    shapes = [degrees(box(*corners)) for corners in _BOXES]
    rows = [{"building": "yes", "height": 9.5 + i, "levels": i, "name": f"h{i}"} for i in range(len(shapes))]
    geojson(folder / name, zip(shapes, rows, strict=True))


def _lines(folder: Path, name: str = "s.geojson") -> None:
    lines = [[(-30.0, 5.0), (25.0, 5.0), (80.0, 8.0)], [(25.0, 5.0), (25.0, 80.0)]]
    rows = [{"highway": "residential", "width": 6.0, "name": "a"}, {"highway": "footway", "width": None, "name": ""}]
    geojson(folder / name, zip([degrees(LineString(one)) for one in lines], rows, strict=True))


def _geojson(folder: Path) -> None:
    _houses(folder, "x.geojson")
    _lines(folder)


def _layers(folder: Path):
    import geopandas

    _geojson(folder)
    found = [geopandas.read_file(folder / name).to_crs("EPSG:32632") for name in ("x.geojson", "s.geojson")]
    for name in ("x.geojson", "s.geojson"):
        (folder / name).unlink()
    return found


def _gpkg(folder: Path) -> None:
    for layer, table in zip(("buildings", "streets"), _layers(folder), strict=True):
        table.to_file(folder / "x.gpkg", layer=layer, driver="GPKG")


def _shp(folder: Path) -> None:
    for name, table in zip("bs", _layers(folder), strict=True):
        table.to_file(folder / f"{name}.shp")
    for path in folder.glob("*.cpg"):
        path.unlink()


def _sumo(folder: Path) -> None:
    (folder / "x.net.xml").write_text(_NET)
    _write_obj(folder / "m.obj", None)


# ---------------------------------------------------------------------------------------------------------- models


def _boxes():
    return [box_corners(x0, y0, 0.0, x1, y1, 6.0 + i) for i, (x0, y0, x1, y1) in enumerate(_BOXES)]


def _net(folder: Path) -> None:
    (folder / "s.net.xml").write_text(_NET)


def _write_obj(path: Path, library: str | None) -> None:
    lines = ["# boxes"] if library is None else [f"mtllib {library}", "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    for i, corners in enumerate(_boxes()):
        lines += [f"o house{i}", *(f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in corners)]
        if library is not None:
            lines.append(f"usemtl {'brick' if i else 'plain'}")
        corner = "{}" if library is None else "{}/{}"
        lines += ["f " + " ".join(corner.format(8 * i + a + 1, k + 1) for k, a in enumerate(quad)) for quad in QUADS]
    path.write_text("\n".join(lines) + "\n")


def _obj(folder: Path) -> None:
    _net(folder)
    _write_obj(folder / "x.obj", "x.mtl")
    (folder / "x.mtl").write_text("newmtl plain\nKd 0.8 0.2 0.2\nnewmtl brick\nKd 1 1 1\nmap_Kd -s 1 1 bricks.png\n")
    Image.fromarray(chequers("bricks", (150, 40, 30)).image).save(folder / "bricks.png")


def _ply(folder: Path) -> None:
    _net(folder)
    corners = np.concatenate(_boxes()).astype("<f4")
    faces = [[8 * i + a for a in quad] for i in range(len(_BOXES)) for quad in QUADS]
    head = (
        f"ply\nformat {{}} 1.0\ncomment x\nelement vertex {len(corners)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = corners.tobytes() + b"".join(struct.pack("<B4i", 4, *one) for one in faces)
    (folder / "x.ply").write_bytes(head.format("binary_little_endian").encode() + body)
    rows = [*(" ".join(f"{c:g}" for c in one) for one in corners), *("4 " + " ".join(map(str, one)) for one in faces)]
    (folder / "t.ply").write_text(head.format("ascii") + "\n".join(rows) + "\n")


def _off(folder: Path) -> None:
    _net(folder)
    corners = np.concatenate(_boxes())
    faces = [[8 * i + a for a in quad] for i in range(len(_BOXES)) for quad in QUADS]
    rows = [*(" ".join(f"{c:g}" for c in one) for one in corners), *("4 " + " ".join(map(str, one)) for one in faces)]
    (folder / "x.off").write_text(f"OFF\n{len(corners)} {len(faces)} 0\n" + "\n".join(rows) + "\n")


def _stl(folder: Path) -> None:
    _net(folder)
    triangles = np.concatenate([one[BOX_TRIANGLES] for one in _boxes()]).astype("<f4")
    body = b"".join(bytes(12) + one.tobytes() + bytes(2) for one in triangles)
    (folder / "x.stl").write_bytes(bytes(80) + len(triangles).to_bytes(4, "little") + body)


def _cityjson(folder: Path) -> None:
    write_cityjson(model_city(), folder / "x.city.json")


def _cityjsonl(folder: Path) -> None:
    write_cityjson(model_city(), folder / "x.city.jsonl")


def _glb(folder: Path) -> None:
    write_glb(model_city(), folder / "x.glb")


def _gltf(folder: Path) -> None:
    write_glb(model_city(), folder / "x.glb")
    data = (folder / "x.glb").read_bytes()
    (folder / "x.glb").unlink()
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    document["buffers"][0]["uri"] = "x.bin"
    (folder / "x.gltf").write_text(json.dumps(document))
    (folder / "x.bin").write_bytes(data[28 + size :])


def _citygml(folder: Path) -> None:
    _lines(folder)
    spaces = ' xmlns:gml="http://www.opengis.net/gml" xmlns:xlink="http://www.w3.org/1999/xlink"' + "".join(
        f' xmlns:{name}="http://www.opengis.net/citygml/{path}2.0"'
        for name, path in (("core", ""), ("bldg", "building/"), ("app", "appearance/"))
    )
    houses = []
    for i, corners in enumerate(_boxes()):
        faces = []
        for k, quad in enumerate(QUADS):
            points = [*corners[list(quad)], corners[quad[0]]]
            numbers = " ".join(f"{x + 500000:.2f} {y + 5316486:.2f} {z:.2f}" for x, y, z in points)
            faces.append(
                f'<gml:surfaceMember><gml:Polygon gml:id="p{i}-{k}"><gml:exterior><gml:LinearRing gml:id="p{i}-{k}-r">'
                f'<gml:posList srsDimension="3">{numbers}</gml:posList></gml:LinearRing></gml:exterior></gml:Polygon>'
                "</gml:surfaceMember>"
            )
        linked = '<gml:surfaceMember xlink:href="#p2-0"/>' if i == 2 else ""
        houses.append(
            f'<core:cityObjectMember><bldg:Building gml:id="b{i}"><bldg:measuredHeight uom="m">6</bldg:measuredHeight>'
            "<bldg:lod2Solid><gml:Solid><gml:exterior><gml:CompositeSurface>" + "".join(faces) + linked
            + "</gml:CompositeSurface></gml:exterior></gml:Solid></bldg:lod2Solid></bldg:Building></core:cityObjectMember>"
        )  # fmt: skip
    looks = (
        "<app:appearanceMember><app:Appearance><app:surfaceDataMember><app:X3DMaterial><app:diffuseColor>0.8 0.2 0.2"
        "</app:diffuseColor><app:target>#p0-1</app:target></app:X3DMaterial></app:surfaceDataMember></app:Appearance>"
        "</app:appearanceMember>"
    )
    (folder / "x.gml").write_text(
        f'<?xml version="1.0"?>\n<core:CityModel{spaces}><gml:boundedBy><gml:Envelope srsName="EPSG:32632" srsDimension="3"/>'
        f"</gml:boundedBy>{''.join(houses)}{looks}</core:CityModel>"
    )


# ---------------------------------------------------------------------------------------------------------- ground


def _tif(folder: Path) -> None:
    import rasterio
    from rasterio.transform import from_origin

    _osm(folder)
    place = degrees(LineString([(-100.0, 120.0), (200.0, -100.0)]))
    (left, top), (right, bottom) = place.coords
    heights = np.fromfunction(lambda i, j: 400.0 + 0.3 * i + 0.2 * j, (24, 24)).astype(np.float32)
    transform = from_origin(left, top, (right - left) / 24, (top - bottom) / 24)
    with rasterio.open(
        folder / "x.tif", "w", driver="GTiff", width=24, height=24, count=1, dtype="float32", crs="EPSG:4326",
        transform=transform, nodata=-9999.0,
    ) as raster:  # fmt: skip
        raster.write(heights, 1)


def _asc(folder: Path) -> None:
    _osm(folder)
    place = degrees(LineString([(-100.0, -100.0), (200.0, 100.0)]))
    (left, bottom), (right, _) = place.coords
    rows = "\n".join(" ".join(f"{400.0 + 0.3 * i + 0.2 * j:.2f}" for j in range(20)) for i in range(20))
    (folder / "x.asc").write_text(
        f"ncols 20\nnrows 20\nxllcorner {left:.8f}\nyllcorner {bottom:.8f}\ncellsize {(right - left) / 20:.10f}\n"
        f"NODATA_value -9999\n{rows}\n"
    )
    from pyproj import CRS

    (folder / "x.prj").write_text(CRS("EPSG:4326").to_wkt("WKT1_ESRI"))


# ----------------------------------------------------------------------------------------- walks, movers and datasets


def _walk(folder: Path) -> None:
    keyframes = (
        Keyframe(0.0, Pose((20.0, 0.0, 1.7), 0.2, 0.0)),
        Keyframe(4.0, Pose((60.0, 0.0, 1.7), -0.2, 0.1)),
        Keyframe(4.0, Pose((0.0, 30.0, 1.7), 1.2, 0.0), True),
        Keyframe(9.0, Pose((0.0, 60.0, 1.7), 1.0, 0.0)),
    )
    write_walk(Walk("round", keyframes), folder / "walk.json")


def _movers(folder: Path) -> None:
    tracks = [[(0.0, 0.0, 0.0, 0.0, 0.0), (2.0, 10.0, 0.0, 0.0, 0.0)], [(1.0, 5.0, 5.0, 0.0, 90.0, 1.0, 2.0)]]
    write_movers(movers_of(tracks, stays=[True, False], crs="EPSG:32631"), folder / "movers.json")


def _dataset(folder: Path) -> None:
    """Cells of several layers a sector."""
    _build(folder, crossroads(), ("block/33", 2.0), near_distance=30.0)


def _walked_dataset(folder: Path) -> None:
    """The same with a walk along its cell, and a mover that comes along."""
    _dataset(folder)
    keyframes = (
        Keyframe(0.0, Pose((0.0, -130.0, 1.7), 1.5, 0.0)),
        Keyframe(1.0, Pose((0.0, -110.0, 1.7), 1.2, 0.1)),
    )
    write_walk(Walk("north", keyframes), folder / "walk.json")
    tracks = [[(0.0, 0.0, -100.0, 0.0, 0.0), (2.0, 0.0, -80.0, 0.0, 90.0)]]
    write_movers(movers_of(tracks, crs="EPSG:32631"), folder / "movers.json")


def _resumable(folder: Path) -> None:
    """A city, and the dataset that the program built of it."""
    write_cityjson(crossroads(), folder / "x.city.json")
    try:
        build_impostors([str(folder / "x.city.json"), "-o", str(folder / "out"), *BUILD])
    except SystemExit as left:
        if left.code:
            raise


def _model_dataset(folder: Path) -> None:
    """A city of prisms, meshes, pictures and relief."""
    _build(folder, model_city(), ("way/2", 2.0), near_distance=8.0)


def _build(folder: Path, city: City, landmark: tuple[str, float], *, near_distance: float) -> None:
    """A dataset of one cell, whose facades are made small: they would be nearly all of it."""
    camera = Camera(64, 64, math.radians(60.0))
    parameters = BuildParameters(near_distance=near_distance, camera=camera, cell_length=80.0, landmarks=(landmark,))
    build_dataset(city, folder, parameters, max_cells=1)
    contents = read_glb((folder / "city.glb").read_bytes(), name="city.glb")
    images = []
    for one in contents.images:
        with Image.open(io.BytesIO(one.data)) as picture:
            images.append(replace(one, data=png_bytes(np.array(picture.resize((16, 16))))))
    changed = {"city.glb": glb_bytes(replace(contents, images=tuple(images)))}
    (folder / "city.glb").write_bytes(changed["city.glb"])
    manifest = resealed({"manifest.json": (folder / "manifest.json").read_bytes()}, changed)["manifest.json"]
    (folder / "manifest.json").write_bytes(manifest)


_WRITERS = {
    "osm": _osm, "osm.gz": _osm_gz, "pbf": _pbf, "geojson": _geojson, "gpkg": _gpkg, "shp": _shp, "sumo": _sumo,
    "cityjson": _cityjson, "cityjsonl": _cityjsonl, "citygml": _citygml, "glb": _glb, "gltf": _gltf, "obj": _obj, "ply": _ply,
    "ply-text": _ply, "off": _off, "stl": _stl, "tif": _tif, "asc": _asc, "walk": _walk, "movers": _movers,
    **dict.fromkeys(("manifest", "record", "cell-exr", "cell-glb"), _dataset),
    **dict.fromkeys(("city", "city-glb"), _model_dataset),
    **dict.fromkeys(("inspect-layers", "compare-impostors", "view-impostors", "compare-walk"), _walked_dataset),
    "build-impostors": _resumable,
}  # fmt: skip
