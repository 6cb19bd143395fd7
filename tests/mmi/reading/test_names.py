"""Names made unique: as counting one by one would do it, but without counting again for each repeat."""

import shapely
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mmi.reading.names import UniqueNames
from mmi.reading.pictures import PictureShelf
from mmi.reading.raw_layers import RawBuilding, with_unique_ids
from mmi.reading.report import Ledger


class CountedName(str):
    """A name that counts how often a numbered name is made of it."""

    __slots__ = ("made",)

    def __new__(cls, text):
        name = super().__new__(cls, text)
        name.made = 0
        return name

    def __format__(self, how):
        self.made += 1
        return super().__format__(how)


def one_by_one(names):
    """The oracle: for each repeat, try every number from 2 on."""
    seen = []
    for name in names:
        number, tried = 2, name
        while tried in seen:
            tried, number = f"{name}#{number}", number + 1
        seen.append(tried)
    return seen


@given(st.lists(st.sampled_from(["a", "a#2", "a#3", "a#2#2", "b", ""]), max_size=14))
def test_numbers_are_those_of_counting_one_by_one(names):
    unique = UniqueNames()
    found = []
    for name in names:
        found.append(unique.free(name))
        unique.take(found[-1])
    assert found == one_by_one(names)


def test_a_name_that_is_not_taken_stays_free():
    unique = UniqueNames()
    unique.take("a")
    assert [unique.free("a"), unique.free("a"), unique.free("b")] == ["a#2", "a#2", "b"]


def test_many_equal_ids_are_numbered_without_counting_again():
    name, place = CountedName("house"), shapely.box(0, 0, 1, 1)
    ledger = Ledger()
    items = with_unique_ids([RawBuilding(name, place, {})] * 3000, ledger)
    assert [one.id for one in items] == ["house", *(f"house#{n}" for n in range(2, 3001))]
    assert ledger.count("repaired", "repeated id made unique") == 2999
    assert name.made <= 2 * 3000  # one by one it is 4.5 million


def test_many_pictures_of_one_name_are_numbered_without_counting_again(tmp_path):
    name, shelf = CountedName("wall.bmp"), PictureShelf(Ledger())
    for shade in range(200):
        Image.new("RGB", (1, 1), (shade, 0, 0)).save(tmp_path / "wall.bmp")
        shelf.place((tmp_path / "wall.bmp").read_bytes(), name, alpha=False)
    assert [one.name for one in shelf.textures()] == ["wall.bmp", *(f"wall.bmp#{n}" for n in range(2, 201))]
    assert name.made <= 2 * 200  # one by one it is 20,000
