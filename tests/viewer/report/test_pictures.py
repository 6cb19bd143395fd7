import numpy as np
import pytest
from PIL import Image

from mmi.foundation.errors import DatasetError
from viewer.report.pictures import save_picture, side_by_side, triptych

ORANGE = (230, 159, 0)


def flat(color, shape=(40, 60)):
    return np.full((*shape, 3), color, dtype=np.uint8)


def mask(*parts, shape=(40, 60)):
    result = np.zeros(shape, dtype=bool)
    for rows, columns in parts:
        result[slice(*rows), slice(*columns)] = True
    return result


def panels_of(picture, shape=(40, 60), count=3):
    """The panels below their captions, left to right: 4 pixels between them, a caption of 18."""
    return [picture[18 : 18 + shape[0], i * (shape[1] + 4) :][:, : shape[1]] for i in range(count)]


def is_orange(panel):
    return (panel == ORANGE).all(axis=2)


def test_marks_lie_on_the_dimmed_geometry():
    wrong, holes = mask(((5, 8), (10, 14)), ((30, 31), (50, 51))), mask(((30, 31), (50, 51)))
    picture = triptych(flat((200, 100, 40)), flat((10, 20, 30)), wrong, holes)
    truth, shown, marks = panels_of(picture)
    outside = ~is_orange(marks)
    assert (marks[wrong & ~holes] == 255).all()
    assert (marks[holes] == (255, 0, 255)).all()
    assert (marks[outside & ~wrong] == (50, 25, 10)).all()
    assert (truth[outside] == (200, 100, 40)).all()
    assert (shown[outside] == (10, 20, 30)).all()


def test_the_thickest_region_is_framed_and_nothing_of_it_hidden():
    """A long line has more pixels than a small square, which is what one would notice."""
    square = ((20, 24), (30, 34))
    picture = triptych(flat(0), flat(0), mask(square, ((2, 3), (0, 60))), mask())
    for panel in panels_of(picture):
        rows, columns = np.nonzero(is_orange(panel))
        assert (rows.min(), rows.max(), columns.min(), columns.max()) == (16, 27, 26, 37)
        assert not is_orange(panel)[20:24, 30:34].any()
        assert not is_orange(panel)[18:26, 28:36].any()  # a frame, not a filled box


def test_of_equally_thick_regions_the_largest_is_framed():
    picture = triptych(flat(0), flat(0), mask(((5, 6), (5, 6)), ((20, 21), (30, 40))), mask())
    _, columns = np.nonzero(is_orange(panels_of(picture)[0]))
    assert (columns.min(), columns.max()) == (26, 43)


def test_regions_that_touch_at_a_corner_are_one():
    picture = triptych(flat(0), flat(0), mask(((20, 23), (20, 23)), ((23, 26), (23, 26))), mask())
    rows, _ = np.nonzero(is_orange(panels_of(picture)[0]))
    assert (rows.min(), rows.max()) == (16, 29)


def test_a_frame_stays_inside_the_panel():
    picture = triptych(flat(0), flat(0), mask(((0, 40), (0, 60))), mask())
    assert np.argwhere(is_orange(panels_of(picture)[0])).min(axis=0).tolist() == [0, 0]


def test_nothing_wrong_nothing_framed():
    assert not is_orange(triptych(flat(90), flat(90), mask(), mask())).any()


def test_inputs_are_left_as_they_were():
    truth, wrong = flat(90), mask(((3, 9), (3, 9)))
    triptych(truth, truth, wrong, wrong)
    assert (truth == 90).all()


@pytest.mark.parametrize("shape", [(40, 60), (41, 61), (1, 1), (7, 640)])
def test_sizes_are_even_and_captions_are_over_their_panels(shape):
    one, other = flat((250, 0, 0), shape), flat((0, 0, 250), shape)
    picture = side_by_side([one, other], ["first", "a much longer title that cannot fit over a narrow panel"])
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    assert picture.dtype == np.uint8
    strip = picture.shape[0] - shape[0] - (shape[0] + max(12, shape[1] // 24) * 3 // 2) % 2
    assert (picture[strip : strip + shape[0], : shape[1]] == one).all()
    assert (picture[strip : strip + shape[0], shape[1] + 4 :][:, : shape[1]] == other).all()
    assert (picture[:strip, shape[1] : shape[1] + 4] == 255).all()  # a title ends with its panel
    if shape[1] > 1:
        assert (picture[:strip, : shape[1]] < 128).any()


def test_titles_are_read_as_given():
    plain, other = (side_by_side([flat(0)], [title]) for title in ("local", "visible"))
    assert not np.array_equal(plain[:18], other[:18])


def test_unlike_panels_are_refused():
    with pytest.raises(ValueError, match=r"\(40, 60, 3\), \(40, 61, 3\)"):
        side_by_side([flat(0), flat(0, (40, 61))], ["a", "b"])
    with pytest.raises(ValueError, match="1 titles"):
        side_by_side([flat(0), flat(0)], ["a"])
    with pytest.raises(ValueError, match="of one size"):
        triptych(flat(0), flat(0), mask(shape=(40, 61)), mask())


def test_saved_pictures_come_back_and_do_not_change(tmp_path):
    pixels = np.random.default_rng(1).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    path = tmp_path / "worst" / "a.png"
    save_picture(path, pixels)
    first = path.read_bytes()
    save_picture(path, pixels)
    assert path.read_bytes() == first
    assert np.array_equal(np.asarray(Image.open(path)), pixels)
    assert [one.name for one in path.parent.iterdir()] == ["a.png"]


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    (tmp_path / "a.png").mkdir()
    for path in (tmp_path / "file" / "a.png", tmp_path / "a.png"):
        with pytest.raises(DatasetError, match=f"{path}: a writable file expected, found"):
            save_picture(path, flat(0))
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.png", "file"]
