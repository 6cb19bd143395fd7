import numpy as np

from mmi.dilation import dilate


def test_covered_texels_keep_their_color_and_neighbours_take_it():
    color = np.zeros((9, 9, 3), dtype=np.uint8)
    covered = np.zeros((9, 9), dtype=bool)
    color[4, 4], covered[4, 4] = (200, 100, 50), True
    filled = dilate(color, covered, 2)
    assert filled[4, 4].tolist() == [200, 100, 50]
    assert (filled == [200, 100, 50]).all()  # two rings take it, the rest takes the mean, which is it


def test_rings_are_filled_from_the_inside():
    color = np.zeros((1, 8, 3), dtype=np.uint8)
    covered = np.zeros((1, 8), dtype=bool)
    color[0, 0], color[0, 7] = 240, 40
    covered[0, [0, 7]] = True
    assert dilate(color, covered, 2)[0, :, 0].tolist() == [240, 240, 240, 140, 140, 40, 40, 40]


def test_nothing_covered_stays_as_it_is():
    color = np.full((3, 3, 3), 7, dtype=np.uint8)
    assert (dilate(color, np.zeros((3, 3), dtype=bool), 2) == 7).all()
