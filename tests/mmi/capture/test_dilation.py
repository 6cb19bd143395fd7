import numpy as np

from mmi.capture.dilation import dilate


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


def _plain(color, covered, reach):
    """The twin: whole rings at a time, with numpy."""
    result, filled = color.astype(float), covered.copy()
    for _ in range(reach):
        total, count = np.zeros(color.shape), np.zeros(covered.shape)
        padded, known = np.pad(result, ((1, 1), (1, 1), (0, 0))), np.pad(filled, 1)
        for i in range(3):
            for j in range(3):
                near = known[i : i + covered.shape[0], j : j + covered.shape[1]]
                total += np.where(near[..., None], padded[i : i + covered.shape[0], j : j + covered.shape[1]], 0.0)
                count += near
        ring = ~filled & (count > 0)
        result[ring] = np.rint(total[ring] / count[ring][:, None])
        filled |= ring
    result[~filled] = np.rint(color[covered].mean(axis=0))
    return result.astype(np.uint8)


def test_the_kernel_agrees_with_its_plain_twin():
    rng = np.random.default_rng(0)
    for share in (0.001, 0.05, 0.6):
        covered = rng.uniform(size=(40, 50)) < share
        covered[3, 4] = True
        color = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
        np.testing.assert_array_equal(dilate(color, covered, 4), _plain(color, covered, 4))
