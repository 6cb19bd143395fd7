"""The program citygen: files, statistics, and one line for every mistake."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import shapely

from citygen.cli import citygen
from citygen.presets import PRESETS
from mmi.movers.movers_file import read_movers
from mmi.reading.read_city import read_city

HELSINKI = Path(__file__).resolve().parents[2] / "examples" / "helsinki" / "helsinki.osm.pbf"


def run(capsys, *arguments):
    """Exit status, standard output, standard error."""
    with pytest.raises(SystemExit) as left:
        citygen([str(one) for one in arguments])
    said = capsys.readouterr()
    return left.value.code, said.out, said.err


def test_writes_a_city_in_every_format(tmp_path, capsys):
    files = [tmp_path / "new" / f"hamlet{suffix}" for suffix in (".json", ".jsonl", ".glb")]
    outputs = [part for file in files for part in ("-o", file)]
    status, out, err = run(capsys, "hamlet", "--detail", 0, "--json", *outputs)
    assert (status, err) == (0, "")
    count = json.loads(out)
    assert count["buildings"] == 12
    assert count["blocks"] == count["street_segments"] - count["junctions"] + 1
    document = json.loads(files[0].read_text(encoding="utf-8"))
    assert document["type"] == "CityJSON"
    assert sum(one["type"] == "Building" for one in document["CityObjects"].values()) == 12
    assert files[2].read_bytes()[:4] == b"glTF"
    lines = files[1].read_text(encoding="utf-8").splitlines()
    assert sum(json.loads(line)["type"] == "CityJSONFeature" for line in lines) >= 12
    assert sorted(file.name for file in files[0].parent.iterdir()) == sorted(file.name for file in files)


def test_same_seed_same_bytes(tmp_path, capsys):
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        run(capsys, "hamlet", "--detail", 0, "--seed", seed, "-o", tmp_path / f"{name}.json")
    a, b, c = ((tmp_path / f"{name}.json").read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_prints_statistics(tmp_path, capsys):
    status, out, _ = run(capsys, "hamlet", "--detail", 0, "-o", tmp_path / "a.json")
    assert status == 0
    assert "12 buildings" in out
    assert "junctions" in out
    assert run(capsys, "hamlet", "--detail", 0, "--quiet", "-o", tmp_path / "a.json") == (0, "", "")


def test_lists_presets(capsys):
    status, out, _ = run(capsys, "--list")
    assert status == 0
    assert [line.split()[0] for line in out.splitlines()] == list(PRESETS)


def test_help_has_an_example_that_is_understood(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "--help")
    assert status == 0
    example = next(line for line in out.splitlines() if line.startswith("  citygen hamlet"))
    assert run(capsys, *shlex.split(example)[1:])[0] == 0
    assert (tmp_path / "out" / "hamlet.json").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "a preset of"),
        (("hamlet",), "-o FILE expected"),
        (("atlantis", "-o", "a.json"), "found 'atlantis'"),
        (("hamlet", "-o", "a.obj"), "found '.obj'"),
        (("hamlet", "-o", "a"), "found ''"),
        (("hamlet", "-o", ""), "a path expected"),
        (("hamlet", "-o", "a.json", "-o", "a.json"), "the same twice"),
        (("hamlet", "-o", "taken/a.json"), "taken"),
        (("hamlet", "-o", "folder.json"), "found a folder"),
        (("hamlet", "--seed", "-1", "-o", "a.json"), "--seed"),
        (("hamlet", "--seed", "one", "-o", "a.json"), "--seed"),
        (("hamlet", "--detail", "7", "-o", "a.json"), "--detail: 0 to 3 expected, found 7"),
        (("hamlet", "--buildings", "2000", "-o", "a.json"), "only metropolis"),
        (("metropolis", "--buildings", "3", "-o", "a.json"), "1000 to 1000000 expected, found 3"),
        (("metropolis", "--buildings", "100000", "-o", "a.json"), "one .jsonl file expected"),
        (("hamlet", "--vehicles", "9", "-o", "a.json"), "--vehicles: only traffic takes it, not hamlet"),
        (("hamlet", "--seconds", "9", "-o", "a.json"), "--seconds: only traffic takes it, not hamlet"),
        (("hamlet", "--city", "b.json", "-o", "a.json"), "--city: only traffic takes it, not hamlet"),
        (("traffic", "--vehicles", "0", "-o", "a.json"), "--vehicles: 1 to 100000 expected, found 0"),
        (("traffic", "--seconds", "nan", "-o", "a.json"), "--seconds: more than 0 and up to 3600 expected, found nan"),
        (("traffic", "--vehicles", "100000", "--seconds", "3600", "-o", "a.json"), "a product of up to 5000000"),
        (("traffic", "--city", "b.json", "-o", "a.json"), "b.json: no such file or folder"),
        (("traffic", "--city", "b.json", "-o", "a.glb"), "a name that ends in .json expected, found '.glb'"),
        (
            ("traffic", "--city", "b.json", "-o", "a.json", "-o", "c.json"),
            "one file for the vehicles expected, found 2",
        ),
        (("traffic", "--city", "b.json", "--detail", "1", "-o", "a.json"), "--detail: a city to generate expected"),
        (("traffic", "--city", "taken", "-o", "a.json"), "taken"),
    ],
)
def test_mistakes_are_one_line(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("a file")
    (tmp_path / "folder.json").mkdir()
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("citygen: error: ")
    assert err.count("\n") == 1
    assert message in err
    assert not (tmp_path / "a.json").exists()


def test_vehicles_drive_through_a_real_city(tmp_path, capsys):
    """On its ground, along its streets for cars, in the frame that the city is read in."""
    file = tmp_path / "cars.json"
    arguments = ("traffic", "--city", HELSINKI, "--vehicles", 40, "--seconds", 8, "-o", file)
    status, out, err = run(capsys, *arguments, "--json")
    assert (status, err) == (0, "")
    assert [one.name for one in tmp_path.iterdir()] == ["cars.json"]
    movers, (city, _) = read_movers(file), read_city(HELSINKI)
    assert json.loads(out) == {
        "vehicles": 40,
        "poses": len(movers.times),
        "seconds": 8.0,
        "street_segments": city.streets.number_of_edges(),
    }
    assert (movers.crs, movers.origin) == (city.crs, city.origin)
    streets = shapely.union_all([e["geometry"].buffer(e["half_width"]) for *_, e in city.streets.edges(data=True)])
    for moment in (0.0, 3.33, 8.0):
        places = movers.poses(moment)[:, :3, 3]
        assert np.allclose(places[:, 2], city.ground_at(places))
        assert shapely.distance(streets, shapely.points(places[:, :2])).max() < 0.5
    way = np.linalg.norm(movers.poses(8.0)[:, :2, 3] - movers.poses(0.0)[:, :2, 3], axis=1)
    assert (way > 5.0).sum() > 10
    before = file.read_bytes()
    assert run(capsys, *arguments, "--seed", 1, "--quiet") == (0, "", "")
    assert file.read_bytes() != before
    assert run(capsys, *arguments)[0] == 0
    assert file.read_bytes() == before


def test_traffic_stands_beside_its_city(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, err = run(
        capsys, "traffic", "--detail", 0, "--vehicles", 7, "--seconds", 1, "--quiet", "-o", "town.json"
    )
    assert (status, err) == (0, "")
    movers = read_movers(tmp_path / "town.traffic.json")
    assert (len(movers.ids), movers.span, movers.crs) == (7, (0.0, 1.0), "local")


def test_who_generates_a_town_is_told_of_its_vehicles(tmp_path, capsys):
    few = ("traffic", "--detail", 0, "--vehicles", 7, "--seconds", 1, "-o", tmp_path / "town.json")
    assert run(capsys, *few)[1].endswith(", 7 vehicles\n")
    assert json.loads(run(capsys, *few, "--json")[1])["vehicles"] == 7
    assert "vehicles" not in run(capsys, "hamlet", "-o", tmp_path / "hamlet.json")[1]


def test_a_city_that_is_too_small_is_said(tmp_path, capsys):
    arguments = ("traffic", "--city", HELSINKI, "--vehicles", 90000, "--seconds", 1, "-o", tmp_path / "a.json")
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "")
    assert err.startswith(
        "citygen: error: helsinki.osm.pbf: streets with room for 90000 vehicles expected, found room for "
    )
    assert err.count("\n") == 1
    assert not (tmp_path / "a.json").exists()


def test_large_metropolis_goes_to_its_file_by_districts(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("citygen.cli._LARGE", 1000)
    file = tmp_path / "big.jsonl"
    status, out, err = run(capsys, "metropolis", "--buildings", 1200, "--json", "-o", file)
    assert (status, err) == (0, "")
    count = json.loads(out)
    assert count["buildings"] == 1200
    entries = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    kinds = [one["type"] for entry in entries[1:] for one in entry["CityObjects"].values()]
    assert kinds.count("Building") == 1200
    assert kinds.count("Road") == count["street_segments"]
