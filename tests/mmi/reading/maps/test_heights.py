"""Heights: reading them from tags, and guessing the others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmi.reading.maps.heights import Heights, heights_from_neighbours, heights_from_tags, parse_metres, settle_span
from mmi.reading.report import Ledger


@pytest.mark.parametrize(
    ("text", "metres"),
    [
        ("12", 12.0),
        (" 12.5 m ", 12.5),
        ("12,5", 12.5),
        ("12.13 m", 12.13),
        ("40'", 40 * 0.3048),
        ("40 ft", 40 * 0.3048),
        ("12'6\"", 12.5 * 0.3048),
        ("12 metres", 12.0),
        ("450 cm", 4.5),
        ("-3", -3.0),
        ("~10", 10.0),
        ("", None),
        ("tall", None),
        ("10;12", None),
        ("1e3", None),
        ("nan", None),
    ],
)
def test_parse_metres(text, metres):
    found = parse_metres(text)
    assert found is None if metres is None else found == pytest.approx(metres)


@given(
    st.floats(0.01, 999, allow_nan=False).map(lambda x: round(x, 3)),
    st.sampled_from(["{}", "{} m", "{}m", " {}  meters"]),
)
def test_parse_metres_reads_what_is_written(metres, form):
    assert parse_metres(form.format(metres)) == pytest.approx(metres)


def read(**tags):
    ledger = Ledger()
    tags = {key.replace("__", ":"): value for key, value in tags.items()}
    return heights_from_tags("way/1", tags, ledger, height_label="height tag", levels_label="levels"), ledger


def test_height_beats_levels():
    heights, ledger = read(height="10", building__levels="9")
    assert heights.top == 10.0
    assert ledger.count("inferred", "height from height tag") == 1


def test_levels_are_3_2_metres_each():
    heights, ledger = read(building__levels="5", building__min_level="2")
    assert heights.top == pytest.approx(16.0)
    assert heights.bottom == pytest.approx(6.4)
    assert ledger.count("inferred", "height from levels x 3.2 m") == 1


@pytest.mark.parametrize("height", ["0", "-5", "1001", "99999999"])
def test_absurd_heights_are_counted_and_levels_used(height):
    heights, ledger = read(height=height, building__levels="2")
    assert heights.top == pytest.approx(6.4)
    assert ledger.count("repaired", "absurd height ignored") == 1


def test_words_for_heights_are_counted():
    heights, ledger = read(height="high")
    assert heights.top is None
    assert ledger.count("repaired", "height that is no number ignored") == 1


def test_min_height_above_the_height_is_counted():
    ledger = Ledger()
    assert settle_span("way/1", Heights(10.0, 12.0, False), 99.0, ledger) == (0.0, 10.0)
    assert ledger.count("repaired") == 1


def test_a_floating_part_without_height_stays_up():
    bottom, top = settle_span("way/1", Heights(None, 30.0, False), 12.0, Ledger())
    assert bottom == 30.0 < top


def test_an_open_roof_is_a_slab():
    heights, _ = read(building="roof", height="6")
    assert settle_span("way/1", heights, 0.0, Ledger()) == (5.5, 6.0)


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_neighbours_median_against_brute_force(known, seed):
    random = np.random.default_rng(seed)
    places, tops, unknown = (
        random.uniform(0, 100, (known, 2)),
        random.uniform(3, 50, known),
        random.uniform(0, 100, (5, 2)),
    )
    guessed = heights_from_neighbours(unknown, places, tops)
    for place, top in zip(unknown, guessed, strict=True):
        nearest = np.argsort(np.hypot(*(places - place).T))[:8]
        assert top == pytest.approx(np.median(tops[nearest]))
