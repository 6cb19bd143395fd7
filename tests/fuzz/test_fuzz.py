"""Every format fuzzed a little in every run of the tests, by another run of mutants each day; more where slow tests are wanted.

``python -m tests.fuzz`` does the same for as many mutants as one likes.
"""

from __future__ import annotations

import os
import time
from random import Random

import pytest
from fuzz.formats import FORMATS, SEED, Format, mutant_of
from fuzz.mutators import changed_bytes, changed_glb, changed_sqlite
from fuzz.pool import ABSURD, ACCEPTED, CRASH, FAILURES, HANG, MEMORY, REFUSED, TRACEBACK, tried
from fuzz.seeds import read_seeds

from mmi.dataset.manifest import manifest_from_json
from mmi.foundation.errors import CityError, DatasetError

RUN = int(os.environ.get("FUZZ_RUN", time.time() // 86_400))
"""Number of the run: the day."""
MUTANTS = 15
"""Mutants of a format in a usual run, beside the seed."""
OTHERS = {
    **dict.fromkeys(("walk", "movers", "manifest", "record", "sealed-record"), 200),
    "compare-walk": 4,
    "view-impostors": 4,
    "build-impostors": 2,
    "compare-impostors": 1,
    "inspect-layers": 0,
}
"""Mutants of formats of which a second tries hundreds, and of those that take seconds each."""


@pytest.fixture(scope="module")
def seeds():
    return read_seeds([*FORMATS])


@pytest.fixture(scope="module")
def found(seeds):
    """What became of the seeds and of some mutants of all formats, from one child."""
    jobs = [
        (form, number)
        for form in FORMATS.values()
        if (count := OTHERS.get(form.name, MUTANTS))
        for number in (SEED, *range(count))
    ]
    return list(tried(jobs, seeds, RUN))


def failing(found):
    """What failed, and the command that shows it again."""
    return [
        f"{one.outcome}: {one.told}; python -m tests.fuzz --format {one.form} --run {RUN} --first {one.number} --mutants 1"
        for one in found
        if one.outcome in FAILURES
    ]


def test_the_seeds_themselves_are_accepted(found):
    seeds = {one.form: (one.outcome, one.told) for one in found if one.number == SEED}
    assert seeds == {name: (ACCEPTED, "") for name in FORMATS if OTHERS.get(name, MUTANTS)}


def test_mutants_are_read_or_refused_in_one_line(found):
    assert failing(found) == []


@pytest.mark.slow
def test_many_mutants_are_read_or_refused_in_one_line(seeds):
    """Of the programs, which take seconds each, 30."""
    jobs = [
        (form, i) for form in FORMATS.values() for i in range(30 if form.attempt.__module__ == "fuzz.programs" else 300)
    ]
    assert failing(tried(jobs, seeds, RUN)) == []


def test_an_edit_of_a_manifest_that_nobody_sealed_is_refused_or_changes_nothing(seeds):
    form, files = FORMATS["manifest"], seeds["manifest"]
    before = manifest_from_json(files["manifest.json"], name="manifest.json")
    for number in range(200):
        mutant = mutant_of(form, files, RUN, number)["manifest.json"]
        try:
            assert manifest_from_json(mutant, name="manifest.json") == before, number
        except DatasetError as error:
            assert "\n" not in str(error)


# ------------------------------------------------------------------------------- the harness sees what it is there to see


def outcomes(attempt, count=3):
    form = Format("x", {"x": (changed_bytes,)}, attempt)
    return [one.outcome for one in tried([(form, number) for number in range(count)], {"x": {"x": b"seed"}}, 0)]


def test_what_is_raised_is_told_apart():
    def refuse(_folder, _expect):
        raise CityError("one line")

    def two_lines(_folder, _expect):
        raise CityError("one\nmore")

    def fail(_folder, _expect):
        raise KeyError("x")

    def absurd(_folder, expect):
        expect(False, "a house of a million metres")

    def hungry(_folder, _expect):
        bytearray(3 << 30)

    def accept(folder, _expect):
        assert (folder / "x").read_bytes() != b""

    found = [outcomes(one, 1) for one in (refuse, two_lines, fail, absurd, hungry, accept)]
    assert found == [[REFUSED], [TRACEBACK], [TRACEBACK], [ABSURD], [MEMORY], [ACCEPTED]]


def test_a_crash_ends_one_mutant_and_the_others_are_tried(tmp_path):
    def crash_once(_folder, _expect):
        if not (tmp_path / "done").exists():
            (tmp_path / "done").touch()
            os.abort()

    assert outcomes(crash_once) == [CRASH, ACCEPTED, ACCEPTED]


def test_who_never_ends_is_stopped(monkeypatch, tmp_path):
    monkeypatch.setattr("fuzz.pool.CPU_SECONDS", 0)

    def spin(_folder, _expect):
        if not (tmp_path / "done").exists():
            (tmp_path / "done").touch()
            while True:
                pass

    assert outcomes(spin) == [HANG, ACCEPTED, ACCEPTED]


def test_a_mutant_is_made_again_by_its_number(seeds):
    for name, form in FORMATS.items():
        assert mutant_of(form, seeds[name], 3, 7) == mutant_of(form, seeds[name], 3, 7)
        assert any(mutant_of(form, seeds[name], 3, number) != seeds[name] for number in range(5))


def test_containers_are_closed_again(seeds):
    """What was changed inside of a glTF still has the size that its head says, and a GeoPackage is still a database."""
    glb, table = seeds["glb"]["x.glb"], seeds["gpkg"]["x.gpkg"]
    for number in range(20):
        changed = changed_glb(glb, Random(number))
        assert int.from_bytes(changed[8:12], "little") == len(changed)
        assert changed_sqlite(table, Random(number)).startswith(b"SQLite format 3") or number
