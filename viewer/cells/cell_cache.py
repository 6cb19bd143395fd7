"""Cells on their way from disk to the GPU: loaded ahead by a background thread, into a cache bounded in bytes.

A plan says which cells it needs and which it may need next. :class:`CellCache` reads the latter in a thread of its own, most
urgent first, hands their layers to the GPU a few at a time between frames, and forgets the cells that were not needed for
longest when they would take more than the bound. What a walk shows never depends on how fast that went: a cell that is
needed and not there is waited for.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from viewer.cells.loaded_cell import LoadedCell, LoadedLayer
from viewer.plan import CellKey

__all__ = ["CacheReport", "CellCache", "LayerStore"]

_REST = 1.0
"""The background thread rests this many times as long as it has worked, because drawing needs the processor too."""

_Load = Callable[[CellKey, Callable[[], None]], LoadedCell]
_Size = Callable[[CellKey], int]


class LayerStore(Protocol):
    """Where layers are drawn from: a renderer, or a test's double of one."""

    def upload_layer(self, cell: LoadedCell, layer: LoadedLayer) -> bool:
        """Take one of a cell's layers in. True if that is done, False if it has to be asked for again."""
        ...

    def evict(self, cell: CellKey) -> None:
        """Free a cell's layers, however many there are."""
        ...


@dataclass(frozen=True, slots=True)
class CacheReport:
    """What a cache has done so far: ``waited`` seconds for ``waits`` cells that were not there when they were needed."""

    waits: int
    waited: float
    cells_loaded: int
    bytes_loaded: int
    cells_evicted: int
    largest_bytes: int


class CellCache:
    """Cells in memory: what is needed, and of the rest as much as fits into ``capacity`` bytes. Use as a context manager.

    ``load`` reads a cell and runs in the background thread; what it raises is raised again by all later calls here, until
    :meth:`recover`. Between pieces of its work it calls what it gets as second argument, which lets it rest unless a cell is
    waited for.
    ``size`` foretells what a cell takes.
    """

    def __init__(self, load: _Load, size: _Size, store: LayerStore, *, capacity: int = 512 << 20) -> None:
        self._load, self._size, self._store, self._capacity = load, size, store, capacity
        self._lock = threading.Condition()  # guards the next ones, which both threads use
        self._wanted: list[CellKey] = []  # most urgent first
        self._loading: CellKey | None = None
        self._waited_for = False
        self._working_since = 0.0
        self._arrived: dict[CellKey, LoadedCell] = {}
        self._failure: BaseException | None = None
        self._closed = False
        self._target: set[CellKey] = set()  # what should be in memory now
        self._bytes: dict[CellKey, int] = {}  # of all cells in memory, the least recently needed first
        self._uploading: dict[CellKey, tuple[LoadedCell, list[LoadedLayer]]] = {}  # and what is not there yet
        self._report = CacheReport(0, 0.0, 0, 0, 0, 0)
        self._thread = threading.Thread(target=self._work, name="cells ahead", daemon=True)
        self._thread.start()

    def __enter__(self) -> CellCache:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def report(self) -> CacheReport:
        """What the cache has done so far."""
        return self._report

    def close(self) -> None:
        """End the thread and free all cells."""
        with self._lock:
            self._closed = True
            self._lock.notify_all()
        self._thread.join()
        for cell in self._bytes:
            self._store.evict(cell)
        self._bytes.clear()

    def holds(self, cell: CellKey) -> bool:
        """Whether all layers of the cell can be drawn."""
        return cell in self._bytes and cell not in self._uploading

    def want(self, needed: Iterable[CellKey], ahead: Iterable[CellKey] = ()) -> None:
        """Say what is needed now, and what may be needed next, most urgent first. Returns at once.

        Raises what loading raised.
        """
        target = list(dict.fromkeys(needed))
        room = self._capacity - sum(self._size(cell) for cell in target)
        for cell in ahead:
            if cell not in target:
                room -= self._size(cell)
                if room < 0:
                    break
                target.append(cell)
        self._target = set(target)
        for cell in reversed(target):  # to the end of the queue: these go last
            if cell in self._bytes:
                self._bytes[cell] = self._bytes.pop(cell)
        with self._lock:
            self._raise_failure()
            there = {*self._bytes, *self._arrived, self._loading}
            self._wanted = [cell for cell in target if cell not in there]
            self._lock.notify_all()

    def recover(self) -> None:
        """Forget what loading raised, and go on with what is wanted without it."""
        with self._lock:
            self._failure = None
            self._lock.notify_all()

    def require(self, cells: Iterable[CellKey], *, counted: bool = True) -> float:
        """Wait until ``cells`` can be drawn; the seconds that took, which the report counts only where ``counted``.

        Raises what loading raised.
        """
        missing = [cell for cell in cells if not self.holds(cell)]
        if not missing:
            return 0.0
        start = time.perf_counter()
        for cell in missing:
            with self._lock:
                self._target.add(cell)
                self._waited_for = True
                if cell not in self._bytes and cell != self._loading and cell not in self._arrived:
                    self._wanted = [cell, *(one for one in self._wanted if one != cell)]
                self._lock.notify_all()
            while cell not in self._bytes:
                with self._lock:
                    self._lock.wait_for(lambda cell=cell: self._failure or cell in self._arrived)  # type: ignore[misc]
                    self._waited_for = False
                self._take_in()
            while cell in self._uploading:
                self._upload_one(cell)
        seconds = time.perf_counter() - start
        if counted:
            self._count(waits=len(missing), waited=seconds)
        return seconds

    def spend(self, seconds: float) -> float:
        """Upload layers that have arrived, a piece at least and then for at most ``seconds``; the seconds that took."""
        start = time.perf_counter()
        self._take_in()
        while self._uploading:
            self._upload_one(next(iter(self._uploading)))
            if time.perf_counter() - start >= seconds:
                break
        return time.perf_counter() - start

    # ----------------------------------------------------------------------------------------------- this thread

    def _take_in(self) -> None:
        """Let what has arrived into the cache, making room where it is wanted; forget it where it is not and there is none."""
        with self._lock:
            self._raise_failure()
            arrived, self._arrived = self._arrived, {}
        for key, cell in arrived.items():
            self._count(loaded=cell.bytes)
            used = sum(self._bytes.values()) + cell.bytes
            for old in [one for one in self._bytes if one not in self._target]:
                if used <= self._capacity:
                    break
                used -= self._bytes.pop(old)
                self._uploading.pop(old, None)
                self._store.evict(old)
                self._count(evicted=1)
            if used <= self._capacity or key in self._target:
                self._bytes[key] = cell.bytes
                if cell.layers:
                    self._uploading[key] = (cell, list(cell.layers))
                self._count()

    def _upload_one(self, key: CellKey) -> None:
        cell, layers = self._uploading[key]
        if self._store.upload_layer(cell, layers[0]):
            del layers[0]
        if not layers:
            del self._uploading[key]

    def _count(self, *, waits: int = 0, waited: float = 0.0, loaded: int | None = None, evicted: int = 0) -> None:
        last = self._report
        self._report = CacheReport(
            waits=last.waits + waits,
            waited=last.waited + waited,
            cells_loaded=last.cells_loaded + (loaded is not None),
            bytes_loaded=last.bytes_loaded + (loaded or 0),
            cells_evicted=last.cells_evicted + evicted,
            largest_bytes=max(last.largest_bytes, sum(self._bytes.values())),
        )

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    # ------------------------------------------------------------------------------------------ the other thread

    def _work(self) -> None:
        while True:
            with self._lock:
                self._lock.wait_for(lambda: self._closed or (self._wanted and self._failure is None))
                if self._closed:
                    return
                cell = self._loading = self._wanted.pop(0)
            try:
                self._working_since = time.perf_counter()
                loaded = self._load(cell, self._rest)
            except BaseException as error:
                with self._lock:
                    self._failure, self._loading = error, None
                    self._lock.notify_all()
            else:
                with self._lock:
                    self._arrived[cell], self._loading = loaded, None
                    self._lock.notify_all()

    def _rest(self) -> None:
        """Rest in proportion to the work since the last time, as long as nobody waits for a cell."""
        with self._lock:
            worked = time.perf_counter() - self._working_since
            self._lock.wait_for(lambda: self._closed or self._waited_for, timeout=_REST * worked)
        self._working_since = time.perf_counter()
