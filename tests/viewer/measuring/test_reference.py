"""From where its layers were captured, a cell's impostor is the geometry up to resampling: on a real city."""

import numpy as np
import pytest
from cities import HELSINKI

from benchmarks.reference import LEAST_DB, MOST_PX, reference_views, spread_cells
from mmi.building.dataset import build_dataset
from mmi.dataset.reading import open_dataset
from mmi.reading.read_city import read_city
from viewer.scene.scene import open_scene


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference") / "helsinki"
    build_dataset(read_city(HELSINKI)[0], folder, max_cells=3)
    scene = open_scene(open_dataset(folder), name="multi-mesh")
    return list(reference_views(scene, spread_cells(scene, 3)))


def test_every_sector_of_every_cell_is_seen_and_most_show_an_impostor(views):
    assert [view.sector for view in views] == 3 * list(range(6))
    assert len({view.cell for view in views}) == 3
    assert all(view.truth.shape == view.shown.shape == (512, 512, 3) for view in views)
    assert sum(view.impostor_share > 0.01 for view in views) >= 9


def test_nothing_is_wrong_beyond_resampling_and_colours_are_close(views):
    figures = [
        f"{view.cell} s{view.sector}: {view.errors.thickness_px:.1f} px, beyond resampling {view.beyond_px:.1f} px, "
        f"{view.errors.psnr_db:.1f} dB"
        for view in views
    ]
    print(*figures, sep="\n")
    assert max(view.beyond_px for view in views) <= MOST_PX, figures
    assert min(view.errors.psnr_db for view in views) >= LEAST_DB, figures


def test_what_resampling_explains_is_counted_without_it_as_well(views):
    assert max(view.errors.wrong_share for view in views) > 0.0
    for view in views:
        assert view.beyond_px <= view.errors.thickness_px
        assert np.mean(view.beyond.wrong) <= view.errors.wrong_share
