from __future__ import annotations

import tracemalloc
from itertools import pairwise

import numpy as np
import pytest

from mmi.appearance.facades import (
    BAYS,
    ROWS,
    TEXTURE_SIZE,
    blind_strip,
    facade_texture,
    glass_of,
    ground_texture,
    roof_strip,
    storey_v,
)
from mmi.appearance.facades import STYLES as ALL_STYLES

STYLES = np.arange(len(ALL_STYLES))


@pytest.fixture(scope="module")
def atlas() -> np.ndarray:
    return facade_texture()


def texel_row(v: float) -> int:
    return round(float(v) * TEXTURE_SIZE[0])


def test_the_atlas_is_a_constant(atlas):
    assert atlas.shape == (4096, 512, 3)
    assert atlas.dtype == np.uint8
    assert not atlas.flags.writeable
    assert np.array_equal(atlas, facade_texture.__wrapped__())


def test_painting_takes_little_memory():
    """Every worker process paints the atlas (6 MB): as floats, all of it at once would be 25 MB and several times over."""
    tracemalloc.start()
    facade_texture.__wrapped__()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 28e6


def test_bands_and_strips_share_no_texel_and_leave_room_for_mipmaps():
    ranges = [(float(storey_v(s, ROWS)), float(storey_v(s, 0))) for s in STYLES]
    ranges += [
        (float(top[s]), float(bottom[s])) for top, bottom in (blind_strip(STYLES), roof_strip(STYLES)) for s in STYLES
    ]
    rows = sorted((texel_row(top), texel_row(bottom)) for top, bottom in ranges)
    assert rows[0][0] >= 16
    assert rows[-1][1] <= TEXTURE_SIZE[0] - 16
    assert all(top < bottom for top, bottom in rows)
    assert all(after[0] - before[1] >= 32 for before, after in pairwise(rows))


def test_the_padding_repeats_the_edge(atlas):
    for style in STYLES:
        top, bottom = texel_row(storey_v(style, ROWS)), texel_row(storey_v(style, 0))
        assert (atlas[top - 16 : top] == atlas[top]).all()
        assert (atlas[bottom : bottom + 16] == atlas[bottom - 1]).all()


def test_storeys_stack_upwards_by_whole_cells():
    v = storey_v(2, np.arange(ROWS + 1))
    assert np.allclose(np.diff(v) * TEXTURE_SIZE[0], -64)


def test_every_storey_and_bay_shows_glass_and_wall(atlas):
    """Windows are dark, walls are not; a cell with only one of them was left out."""
    for style, one in enumerate(ALL_STYLES):
        for row in range(ROWS):
            low, high = texel_row(storey_v(style, row)), texel_row(storey_v(style, row + 1))
            for bay in range(BAYS):
                cell = atlas[high:low, bay * 64 : (bay + 1) * 64].astype(float).mean(axis=2)
                assert np.ptp(cell) > 70, (one.name, row, bay)


def test_bays_and_storeys_vary(atlas):
    for style in STYLES:
        low, high = texel_row(storey_v(style, 1)), texel_row(storey_v(style, ROWS))
        cells = atlas[high:low].reshape(ROWS - 1, 64, BAYS, 64, 3).swapaxes(1, 2).reshape(-1, 64 * 64 * 3)
        assert len(np.unique(cells, axis=0)) == len(cells)


def test_the_ground_floor_is_not_an_upper_storey(atlas):
    """Doors and shops reach down to the pavement: the ground floor differs from the storey above it a lot."""
    for style in STYLES:
        rows = [texel_row(storey_v(style, row)) for row in (0, 1, 2, 3)]
        ground, first, second = (atlas[b:a].astype(float) for a, b in pairwise(rows))
        assert np.abs(ground - first).mean() > 1.15 * np.abs(first - second).mean()


def test_styles_look_different(atlas):
    means = [atlas[texel_row(storey_v(s, ROWS)) : texel_row(storey_v(s, 0))].mean(axis=(0, 1)) for s in STYLES]
    gaps = [np.linalg.norm(means[i] - means[j]) for i in range(4) for j in range(i)]
    assert min(gaps) > 15


def test_the_ground_texture_is_a_seamless_light_grey():
    texture = ground_texture().astype(float)
    assert texture.shape == (256, 256, 3)
    assert 220 < texture.mean() < 240
    across = np.abs(texture[0] - texture[-1]).mean()
    assert across < 1.5 * np.abs(np.diff(texture, axis=0)).mean()


def test_glass_is_in_the_windows_of_upper_storeys_alone(atlas):
    """Panes are darker than walls, if those are not of glass too; blind walls, roofs and ground floors have none."""
    glass = glass_of(atlas) > 0
    assert glass.shape == atlas.shape[:2]
    bands = np.zeros(len(atlas), dtype=bool)
    for style in STYLES:
        upper = slice(texel_row(storey_v(style, ROWS)), texel_row(storey_v(style, 1)))
        bands[upper] = True
        inside = glass[upper]
        assert 0.05 < inside.mean() < 0.7
        colors = atlas[upper].astype(float)
        if ALL_STYLES[style].name == "glass":
            assert not inside[:, ::32].any() and not inside[:, 1::32].any(), "uprights"
        else:
            assert colors[inside].mean() < 0.9 * colors[~inside].mean()
    assert not glass[~bands].any()


def test_glass_is_found_in_wider_atlases_and_in_no_picture_of_a_city_s_own(atlas):
    beside = np.full((200, 1024, 3), 250, dtype=np.uint8)
    glass = glass_of(np.vstack([np.hstack([atlas, atlas]), beside]))
    assert np.array_equal(glass[:4096, :512], glass_of(atlas)) and np.array_equal(glass[:4096, 512:], glass_of(atlas))
    assert not glass[4096:].any()
    assert not glass_of(beside).any()
    assert not glass_of(np.full_like(atlas, 250)).any()
