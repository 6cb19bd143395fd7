"""GDAL opens what is promised and nothing behind it: no other file, no server, no view of SQL, by whatever name."""

import json
import socket
import sqlite3
import threading
import zipfile
from contextlib import closing

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from city_files import geojson
from shapely.geometry import LineString, box

from mmi.foundation.errors import CityError
from mmi.reading.gdal_files import RASTERS, layers_of, local_path, vector_file
from mmi.reading.ground.relief import read_relief_points
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger

HOUSE = (box(500000, 5300000, 500020, 5300020), {"height": 9})
STREET = (LineString([(499950, 5299990), (500050, 5299990)]), {"highway": "residential"})
UTM = "EPSG:32632"


@pytest.fixture
def secret(tmp_path):
    """What only somebody else should be able to read."""
    (tmp_path / "elsewhere").mkdir()
    return geojson(tmp_path / "elsewhere" / "secret.geojson", [HOUSE, STREET], crs=UTM)


@pytest.fixture
def server():
    """(address, connections): a server that counts who asks it."""
    asked = []
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve():
            while True:
                try:
                    one, who = listening.accept()
                except OSError:
                    return
                asked.append(who)
                one.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{listening.getsockname()[1]}", asked
        listening.shutdown(socket.SHUT_RDWR)
    thread.join(timeout=5.0)


def vrt(source):
    layer = f'<OGRVRTLayer name="secret"><SrcDataSource>{source}</SrcDataSource></OGRVRTLayer>'
    return f"<OGRVRTDataSource>{layer}</OGRVRTDataSource>"


def raster_vrt(source):
    return (
        '<VRTDataset rasterXSize="2" rasterYSize="2"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>'
        f"<SourceFilename>{source}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )


def wms(address):
    return (
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{address}/${{z}}/${{x}}/${{y}}.tif</ServerUrl></Service></GDAL_WMS>'
    )


def lead_elsewhere(source, address):
    """Contents that make GDAL open ``source``, or ask a server."""
    pipeline = {"type": "gdal_streamed_alg", "command_line": f"gdal vector pipeline ! read {source} ! filter"}
    return {
        "VRT": vrt(source),
        "VRT of a server": vrt(f"/vsicurl/{address}/a.geojson"),
        "VRT in the words of a GeoJSON": json.dumps({"note": 0, "type": "FeatureCollection"})[:-1]
        + f', "note": "{vrt(source)}", "features": []}}'.replace('"secret"', "'secret'"),
        "pipeline": json.dumps(pipeline),
        "WFS": f"<OGRWFSDataSource><URL>{address}/wfs</URL></OGRWFSDataSource>",
        "WMS": wms(address),
    }


KINDS = tuple(lead_elsewhere("", ""))


def one_line(caught, path):
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_what_leads_elsewhere_would_be_followed_by_gdal_itself(secret, tmp_path):
    """Else the tests below would show nothing: what they refuse is what GDAL opens."""
    for kind in ("VRT", "VRT in the words of a GeoJSON", "pipeline"):
        path = tmp_path / "city.json"
        path.write_text(lead_elsewhere(secret, "")[kind])
        assert pyogrio.read_info(path)["features"] == 2, kind


@pytest.mark.parametrize("suffix", [".geojson", ".json", ".vrt", ".xml", ".gpkg", ".csv", ".tif"])
@pytest.mark.parametrize("kind", KINDS)
def test_files_that_lead_elsewhere_are_refused(secret, server, tmp_path, kind, suffix):
    address, asked = server
    path = tmp_path / f"city{suffix}"
    path.write_text(lead_elsewhere(secret, address)[kind])
    with pytest.raises(CityError, match="leads to other files or to servers") as caught:
        read_city(path)
    assert "secret" not in one_line(caught, path)
    streets = geojson(tmp_path / "good.geojson", [HOUSE], crs=UTM)
    with pytest.raises(CityError, match="leads to other files or to servers"):
        read_city(streets, ReadOptions(streets=path))
    assert not asked


@pytest.mark.parametrize("suffix", [".tif", ".vrt", ".xml", ".asc", ".img", ".xyz", ".jp2", ".hgt", ".grd"])
def test_rasters_that_lead_elsewhere_are_refused(server, tmp_path, suffix):
    address, asked = server
    real = tmp_path / "secret.tif"
    with rasterio.open(
        real, "w", driver="GTiff", width=2, height=2, count=1, dtype="float32", crs=UTM,
        transform=rasterio.Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 5300000.0),
    ) as raster:  # fmt: skip
        raster.write(np.ones((1, 2, 2), np.float32))
    path = tmp_path / f"heights{suffix}"
    for text in (raster_vrt(real), raster_vrt(f"/vsicurl/{address}/a.tif"), wms(address)):
        path.write_text(text)
        with pytest.raises(CityError, match="expected a raster") as caught:
            read_relief_points(path, Ledger())
        one_line(caught, path)
    assert not asked


@pytest.mark.parametrize(
    "name",
    ["/vsicurl/{}/a.geojson", "/vsizip/vsicurl/{}/a.zip", "{}/a.geojson", "WFS:{}", "/vsimem/a", "zip+{}/a.zip!a.shp"],
)
def test_addresses_are_no_files(server, tmp_path, monkeypatch, name):
    address, asked = server
    monkeypatch.chdir(tmp_path)
    path = name.format(address)
    good = geojson(tmp_path / "good.geojson", [HOUSE, STREET], crs=UTM)
    for arguments in ((path, None), (good, ReadOptions(streets=path)), (good, ReadOptions(terrain=path))):
        with pytest.raises(CityError, match="no such file or folder"):
            read_city(*arguments)
    assert not asked


def test_a_file_that_is_called_like_an_address_is_that_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    geojson(tmp_path / "WFS:a.geojson", [HOUSE, STREET], crs=UTM)
    city, _ = read_city("WFS:a.geojson", ReadOptions(network="all"))
    assert len(city.objects) == 1


def test_names_that_pyogrio_takes_apart_are_told(tmp_path):
    for name in ("a!b.geojson", "a;b.geojson", "a?b.geojson"):
        path = geojson(tmp_path / name, [HOUSE, STREET], crs=UTM)
        with pytest.raises(CityError, match=r"a name without ! ; \? expected") as caught:
            read_city(path)
        one_line(caught, path)


def test_local_paths_are_absolute_and_of_no_virtual_file_system(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert local_path(tmp_path / "a") == tmp_path / "a"
    monkeypatch.chdir("/")
    for path in ("vsicurl/http://a", "/vsizip/a.zip"):
        with pytest.raises(CityError, match="virtual file systems"):
            local_path(type(tmp_path)(path))


def test_all_formats_that_are_promised_are_read(tmp_path):
    shape, where = [shapely.to_wkb(HOUSE[0])], {"geometry_type": "Polygon", "crs": UTM}
    drivers = {
        ".shp": "ESRI Shapefile", ".gpkg": "GPKG", ".fgb": "FlatGeobuf", ".geojson": "GeoJSON", ".geojsonl": "GeoJSONSeq",
    }  # fmt: skip
    for suffix, driver in drivers.items():
        path = tmp_path / f"houses{suffix}"
        pyogrio.raw.write(path, np.array(shape, dtype=object), [np.array([9.0])], ["height"], driver=driver, **where)
        assert layers_of(path, "a city") == (("houses", False),), driver
    table = tmp_path / "houses.csv"
    table.write_text(f'WKT,height\n"{HOUSE[0].wkt}",9\n')
    assert layers_of(table, "a city") == (("houses", False),)


def test_rasters_have_a_driver_for_every_suffix():
    with rasterio.Env() as env:
        known = env.drivers()
    for suffix, drivers in RASTERS:
        assert any(driver in known for driver in drivers), suffix


# ------------------------------------------------------------------------------------------------------ GeoPackages

ENDLESS = (
    "CREATE VIEW {} AS WITH RECURSIVE endless(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM endless) "
    "SELECT x AS fid, geom, height FROM endless, houses"
)


def geopackage(path, *statements):
    shapes = np.array([shapely.to_wkb(HOUSE[0])], dtype=object)
    pyogrio.raw.write(
        path, shapes, [np.array([9.0])], ["height"], layer="houses", driver="GPKG", geometry_type="Polygon", crs=UTM
    )
    with closing(sqlite3.connect(path)) as database:
        for statement in statements:
            database.execute(statement)
        database.commit()
    return path


def with_view(path, name="buildings"):
    return geopackage(
        path,
        ENDLESS.format(name),
        f"INSERT INTO gpkg_contents(table_name, data_type, identifier, srs_id) VALUES ('{name}', 'features', '{name}', 32632)",
        f"INSERT INTO gpkg_geometry_columns VALUES ('{name}', 'geom', 'POLYGON', 32632, 0, 0)",
    )


def test_views_of_a_geopackage_are_not_read_and_its_tables_are(tmp_path):
    """The view has the better name for buildings, and no end."""
    path = with_view(tmp_path / "city.gpkg")
    streets = geojson(tmp_path / "streets.geojson", [STREET], crs=UTM)
    assert layers_of(path, "a city") == (("houses", False), ("buildings", True))
    city, _ = read_city(path, ReadOptions(streets=streets))
    assert len(city.objects) == 1
    with pytest.raises(CityError, match=r"--buildings-layer 'buildings': a table expected, found a view") as caught:
        read_city(path, ReadOptions(streets=streets, buildings_layer="buildings"))
    one_line(caught, path)


def test_a_view_is_no_ground(tmp_path):
    path = with_view(tmp_path / "ground.gpkg", "ground")
    points, _ = read_relief_points(geopackage(tmp_path / "two.gpkg"), Ledger())
    assert len(points) == 5
    with closing(sqlite3.connect(path)) as database:
        database.execute("DELETE FROM gpkg_contents WHERE table_name = 'houses'")
        database.execute("DELETE FROM gpkg_geometry_columns WHERE table_name = 'houses'")
        database.commit()
    with pytest.raises(CityError) as caught:
        read_relief_points(path, Ledger())
    one_line(caught, path)


@pytest.mark.parametrize(
    ("statements", "said"),
    [
        (
            ["ALTER TABLE gpkg_contents RENAME TO hidden", "CREATE VIEW gpkg_contents AS SELECT * FROM hidden"],
            "is a view",
        ),
        (["DROP TABLE gpkg_geometry_columns", "CREATE VIEW gpkg_geometry_columns AS SELECT 1"], "is a view"),
        (["CREATE VIRTUAL TABLE gpkg_more USING rtree(id, a, b)"], "is a virtual table"),
        (["DROP TABLE gpkg_contents"], "no GeoPackage"),
    ],
)
def test_a_geopackage_that_is_described_by_views_is_refused(tmp_path, statements, said):
    path = geopackage(tmp_path / "city.gpkg", *statements)
    with pytest.raises(CityError, match=said) as caught:
        vector_file(path, "a city")
    one_line(caught, path)


def test_other_files_are_told_by_what_they_are(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a.geojson", "{}")
    (tmp_path / "a.kml").write_text("<kml/>")
    (tmp_path / "a.dxf").write_text("  0\nSECTION\n")
    (tmp_path / "a.gpkg").write_bytes(b"SQLite format 3\0" + bytes(200))
    (tmp_path / "a.csv").write_bytes(b"a,b\0")
    for name, said in (
        ("a.zip", "a zip; unpack it"), ("a.kml", "found: XML"), ("a.dxf", "ogr2ogr a.gpkg a.dxf converts it"),
        ("a.gpkg", "a damaged GeoPackage"), ("a.csv", "another kind"),
    ):  # fmt: skip
        with pytest.raises(CityError, match=said) as caught:
            vector_file(tmp_path / name, "a city")
        one_line(caught, tmp_path / name)
