import threading
import time

import numpy as np
import pytest

from mmi.foundation.errors import DatasetError
from viewer.cells.cell_cache import CellCache
from viewer.cells.loaded_cell import LoadedCell, LoadedLayer, StoredPicture
from viewer.plan import CellKey

SIZE = 4 * 4 * 4 + 4 * 4 * 4  # a picture of 4 x 4 texels, and its depths
LAYERS = 3


def key(name):
    return CellKey("made", name)


def cell(where):
    layers = tuple(
        LoadedLayer(
            f"s0.l{i}",
            (0, 0),
            StoredPicture(np.zeros((4, 4, 4), np.uint8), np.ones((4, 4), np.float32), None),
            np.zeros((0, 6), np.float32),
            np.zeros((0, 3), np.int32),
            0,
        )
        for i in range(LAYERS)
    )
    return LoadedCell(where, np.zeros(3), (4, 4 * LAYERS), layers)


class Store:
    """What a renderer would hold."""

    def __init__(self):
        self.layers = {}

    def upload_layer(self, cell, layer):
        self.layers.setdefault(cell.key, []).append(layer.name)
        return True

    def evict(self, where):
        self.layers.pop(where, None)


class Disk:
    """Loads cells when it may, and remembers which; one that does not exist cannot be loaded."""

    def __init__(self):
        self.loaded, self.open = [], threading.Event()
        self.open.set()

    def __call__(self, where, rest):
        assert self.open.wait(10.0)
        if where.cell == "broken":
            raise DatasetError("cells/broken.glb: damaged")
        rest()
        self.loaded.append(where.cell)
        return cell(where)


@pytest.fixture
def made():
    disk, store = Disk(), Store()
    with CellCache(disk, lambda _: LAYERS * SIZE, store, capacity=3 * LAYERS * SIZE) as cache:
        yield cache, disk, store
        disk.open.set()


def settle(cache, store, cells):
    """Give the thread time until these cells are there."""
    end = time.monotonic() + 10.0
    while not all(cache.holds(key(name)) for name in cells):
        assert time.monotonic() < end, f"{cells} expected, found {list(store.layers)}"
        cache.spend(1.0)
        time.sleep(0.001)


def test_what_is_required_is_there_and_whole(made):
    cache, disk, store = made
    assert cache.require([key("a")]) > 0.0
    assert store.layers == {key("a"): ["s0.l0", "s0.l1", "s0.l2"]}
    assert cache.require([key("a")]) == 0.0
    assert disk.loaded == ["a"]
    assert (cache.report.waits, cache.report.cells_loaded) == (1, 1)
    assert cache.report.waited > 0.0


def test_cells_ahead_come_without_being_waited_for_in_order_of_urgency(made):
    cache, disk, store = made
    disk.open.clear()
    cache.want([key("a")], [key("b"), key("c")])
    disk.open.set()
    settle(cache, store, "abc")
    assert disk.loaded == ["a", "b", "c"]
    assert cache.report.waits == 0


def test_a_cell_that_is_being_loaded_is_waited_for_not_loaded_again(made):
    cache, disk, _ = made
    disk.open.clear()
    cache.want([], [key("a")])
    time.sleep(0.05)  # it is on its way
    threading.Timer(0.1, disk.open.set).start()
    cache.require([key("a")])
    assert disk.loaded == ["a"]


def test_a_need_goes_before_what_is_ahead(made):
    cache, disk, _ = made
    disk.open.clear()
    cache.want([], [key("a"), key("b"), key("c")])
    time.sleep(0.05)
    threading.Timer(0.1, disk.open.set).start()
    cache.require([key("urgent")])
    assert disk.loaded[:2] == ["a", "urgent"]


def test_memory_is_bounded_and_the_longest_unneeded_goes_first(made):
    cache, _, store = made
    for name in "abcd":
        cache.want([key(name)])
        cache.require([key(name)])
    assert list(store.layers) == [key("b"), key("c"), key("d")]
    assert cache.report.cells_evicted == 1
    cache.want([key("b")])  # now c is the one that was needed longest ago
    cache.want([key("e")])
    cache.require([key("e")])
    assert set(store.layers) == {key("b"), key("d"), key("e")}
    assert cache.report.largest_bytes == 3 * LAYERS * SIZE


def test_what_is_ahead_never_drives_out_what_is_needed_nor_each_other(made):
    cache, disk, store = made
    ahead = [key(name) for name in "bcdefg"]
    for _ in range(20):
        cache.want([key("a")], ahead)
        cache.require([key("a")])
        cache.spend(1.0)
        time.sleep(0.002)
    settle(cache, store, "abc")
    assert disk.loaded == ["a", "b", "c"], "no more than fits, and nothing twice"
    assert cache.report.cells_evicted == 0


def test_needed_cells_fit_whatever_they_take(made):
    cache, _, store = made
    five = [key(name) for name in "abcde"]
    cache.want(five)
    cache.require(five)
    assert set(store.layers) == set(five)
    cache.want([key("f")])
    cache.require([key("f")])
    assert len(store.layers) == 3


def test_a_damaged_cell_is_told_to_whoever_asks_next(made):
    cache, _, _ = made
    with pytest.raises(DatasetError, match="broken"):
        cache.require([key("broken")])
    with pytest.raises(DatasetError, match="broken"):
        cache.want([key("a")])


def test_after_a_damaged_cell_others_can_be_had(made):
    cache, _, _ = made
    with pytest.raises(DatasetError, match="broken"):
        cache.require([key("broken")])
    cache.recover()
    cache.want([key("a")])
    cache.require([key("a")])
    assert cache.holds(key("a"))


def test_a_damaged_cell_ahead_is_told_as_well(made):
    cache, _, _ = made
    cache.want([], [key("broken")])
    with pytest.raises(DatasetError, match="broken"):
        for _ in range(1000):
            cache.spend(0.0)
            time.sleep(0.001)


def test_uploads_are_few_at_a_time(made):
    cache, disk, store = made
    disk.open.clear()
    cache.want([], [key("a")])
    disk.open.set()
    counts = []
    end = time.monotonic() + 10.0
    while not cache.holds(key("a")) and time.monotonic() < end:
        cache.spend(0.0)
        counts.append(len(store.layers.get(key("a"), [])))
        time.sleep(0.002)
    assert max(np.diff([0, *counts])) == 1


def test_a_store_that_makes_room_first_is_asked_again():
    class Roomy(Store):
        def __init__(self):
            super().__init__()
            self.made = []

        def upload_layer(self, cell, layer):
            if self.made.count(cell.key) < 2:
                self.made.append(cell.key)
                return False
            return super().upload_layer(cell, layer)

    store, where = Roomy(), key("a")
    with CellCache(lambda where, _: cell(where), lambda _: LAYERS * SIZE, store) as cache:
        cache.want([], [where])
        pieces = 0
        while not cache.holds(where):
            pieces += cache.spend(0.0) > 0.0 and where in store.made
        assert pieces >= 2 + LAYERS
        assert store.layers[where] == [layer.name for layer in cell(where).layers]
        assert len(store.made) == 2


def test_a_cell_without_layers_is_there_at_once():
    store = Store()
    with CellCache(lambda where, _: LoadedCell(where, np.zeros(3), (1, 1), ()), lambda _: 0, store) as cache:
        cache.require([key("empty")])
        assert cache.holds(key("empty"))


def test_closing_frees_everything():
    store = Store()
    with CellCache(lambda where, _: cell(where), lambda _: LAYERS * SIZE, store) as cache:
        cache.require([key("a"), key("b")])
    assert store.layers == {}
    assert threading.active_count() < 50


def test_the_thread_rests_after_work_but_not_while_it_is_waited_for():
    work, rests = 0.05, []

    def load(where, rest):
        for _ in range(4):
            time.sleep(work)
            start = time.perf_counter()
            rest()
            rests.append(time.perf_counter() - start)
        return cell(where)

    with CellCache(load, lambda _: LAYERS * SIZE, Store()) as cache:
        cache.want([], [key("a")])
        while not cache.holds(key("a")):
            cache.spend(1.0)
            time.sleep(0.005)
        assert min(rests) > work
        rests.clear()
        cache.want([], [key("b")])
        time.sleep(1.5 * work)  # it works, and rests
        cache.require([key("b")])
        assert max(rests[1:]) < 0.5 * work
