"""The studio: who is drawn when, what ends, and what errors are allowed to end."""

import shutil
import sys
import threading
import time
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as Late

import av
import numpy as np
import pytest

from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.walks.walk import Pose
from viewer.window.commands import AskMap, Film, GoTo, Held, Input, LookChange, Pick, PutAt, Save, Size, WalkCommand
from viewer.window.composing import Pictures
from viewer.window.session import Session
from viewer.window.studio import Studio, StudioClosedError, StudioFullError, StudioOptions

SIZE = (160, 96)
LONG = 60.0


@pytest.fixture(scope="module")
def studio(dataset):
    with Studio(dataset.path, StudioOptions(sessions=3)) as found:
        yield found


@pytest.fixture
def join(studio):
    names = []

    def joined(name, size=SIZE):
        studio.join(name, size)
        names.append(name)
        return name

    yield joined
    for name in names:
        studio.leave(name)


def settled(studio, client):
    """The last frame before there is nothing new any more, and the future of the next."""
    last = None
    while True:
        future = studio.ask(client)
        try:
            last = future.result(0.5 if last is not None else LONG)
        except Late:
            return last, future


def test_what_a_page_is_told(studio):
    about = studio.about()
    assert about["techniques"] == [
        "full",
        "visible",
        "local",
        "multi-mesh",
        "multi-mesh-dynamic",
        "ray-cast",
        "image-cache",
    ]
    assert about["display"] == [256, 256]
    assert about["fov_degrees"] == pytest.approx(60.0)
    assert about["look"]["mode"] == "swipe"
    assert about["layers"] == sorted(about["layers"])
    assert about["device"]


def test_frames_of_several_sizes(studio, join):
    clients = {join("a", (160, 96)): (160, 96), join("b", (97, 131)): (97, 131)}
    for _ in range(2):
        futures = {client: studio.ask(client) for client in clients}
        for client, future in futures.items():
            shown = future.result(LONG)
            assert shown.picture.shape == (*clients[client][::-1], 3)
            assert (shown.header["width"], shown.header["height"]) == clients[client]
    studio.tell("a", Size(200, 80))
    assert studio.ask("a").result(LONG).picture.shape == (80, 200, 3)


def test_a_viewer_who_stands_costs_nothing_until_something_is_told(studio, join):
    client = join("a")
    shown, waiting = settled(studio, client)
    assert shown.header["still"]
    studio.tell(client, Input(7, Held()))  # nothing new
    with pytest.raises(Late):
        waiting.result(0.3)
    studio.tell(client, Input(8, Held(), (0.5, 0.0)))
    after = waiting.result(LONG)
    assert after.header["frame"] == shown.header["frame"] + 1
    assert after.header["seq"] == 8
    assert after.header["pose"][3] != shown.header["pose"][3]


def test_the_latest_input_wins(studio, join):
    client = join("a")
    settled(studio, client)
    for seq in range(1, 50):
        studio.tell(client, Input(seq, Held(forward=1.0), (0.01, 0.0)))
    studio.tell(client, Input(50, Held()))
    before = studio.about()["pose"]
    shown = studio.ask(client).result(LONG)
    assert shown.header["seq"] == 50
    assert shown.header["pose"][3] == pytest.approx(before[3] + 0.49)
    assert shown.header["pose"][:2] == before[:2]


def test_clients_take_turns(studio, join):
    clients = [join("a"), join("b"), join("c")]
    for client in clients:
        studio.tell(client, Input(1, Held(turn=1.0)))
    order = []
    for client in clients:
        for _ in range(4):
            studio.ask(client).add_done_callback(lambda _, client=client: order.append(client))
    end = time.monotonic() + LONG
    while len(order) < 12 and time.monotonic() < end:
        time.sleep(0.01)
    assert sorted(order[-6:]) == sorted(clients * 2)  # nobody is served while others wait longer


def test_one_too_many_is_sent_away_and_comes_in_when_there_is_room(studio, join):
    for name in "abc":
        join(name)
    with pytest.raises(StudioFullError):
        studio.join("d", SIZE)
    studio.leave("b")
    join("d")
    assert studio.ask("d").result(LONG).header["frame"] == 1


def test_who_leaves_waits_for_nothing_any_more(studio, join):
    client = join("a")
    _, waiting = settled(studio, client)
    studio.leave(client)
    with pytest.raises(StudioClosedError):
        waiting.result(LONG)
    with pytest.raises(ParameterError):
        studio.ask(client)
    with pytest.raises(ParameterError):
        studio.tell(client, Input(1))
    studio.leave(client)


def test_a_cancelled_future_is_passed_over(studio, join):
    client = join("a")
    _, waiting = settled(studio, client)
    assert waiting.cancel()
    studio.tell(client, Input(1, Held(), (0.5, 0.0)))
    assert studio.ask(client).result(LONG).header["seq"] == 1
    with pytest.raises(CancelledError):
        waiting.result(0)


def test_nobody_asks_for_too_much(studio, join):
    client = join("a")
    settled(studio, client)
    with pytest.raises(ParameterError, match="at most"):
        for _ in range(20):
            studio.ask(client)


def test_looks_without_meaning_are_refused_at_once(studio, join):
    client = join("a")
    with pytest.raises(ParameterError, match="technique"):
        studio.tell(client, LookChange({"left": "raytracing"}))
    assert studio.ask(client).result(LONG).header["views"][0]["technique"] == "full"


def test_an_error_in_a_frame_is_told_and_the_session_goes_on(studio, join, monkeypatch):
    client, other = join("a"), join("b")
    _, waiting = settled(studio, client)
    draw = Session.frame

    def failing(self, mail, now):
        if self.client == client:
            raise RuntimeError("the sky falls")
        return draw(self, mail, now)

    monkeypatch.setattr(Session, "frame", failing)
    studio.tell(client, Input(1, Held(), (0.5, 0.0)))
    with pytest.raises(RuntimeError, match="the sky falls"):
        waiting.result(LONG)
    waiting = studio.ask(client)
    with pytest.raises(Late):  # it is not drawn again and again
        waiting.result(0.3)
    assert studio.ask(other).result(LONG).header["frame"] == 1
    monkeypatch.undo()
    studio.tell(client, Input(2, Held(), (0.5, 0.0)))
    assert waiting.result(LONG).header["seq"] == 2


def test_who_walks_on_is_drawn_again_after_an_error(studio, join, monkeypatch):
    """A key that is held on is no news, and a tour that goes on is none: neither ever passed a damaged cell."""
    client = join("a")
    _, waiting = settled(studio, client)

    def failing(*_):
        raise RuntimeError("the sky falls")

    monkeypatch.setattr(Pictures, "draw", failing)
    studio.tell(client, Input(1, Held(forward=1.0)))
    for _ in range(3):
        with pytest.raises(RuntimeError, match="the sky falls"):
            waiting.result(LONG)
        waiting = studio.ask(client)
    monkeypatch.undo()
    assert waiting.result(LONG).header["seq"] == 1


def test_a_saved_picture_is_the_one_that_is_shown(studio, join):
    client = join("a")
    shown, _ = settled(studio, client)
    saved = studio.answer(client, Save()).result(LONG)
    assert saved["type"] == "saved"
    assert saved["frame"].picture is shown.picture
    assert saved["frame"].header == shown.header | {"saved": True}
    assert "saved" not in shown.header


def test_walks_are_answered(studio, join):
    client = join("a")
    studio.ask(client).result(LONG)
    assert studio.answer(client, WalkCommand("tour")).result(LONG)["type"] == "walk"
    assert studio.ask(client).result(LONG).header["playing"] == "tour"
    assert studio.answer(client, WalkCommand("stop")).result(LONG) == {"type": "walk", "walk": None}
    with pytest.raises(ParameterError, match="walk to replay"):
        studio.answer(client, WalkCommand("replay")).result(LONG)
    with pytest.raises(ParameterError, match="answer"):
        studio.answer(client, GoTo((0.0, 0.0))).result(LONG)


def test_what_is_at_a_pixel(studio, join):
    client = join("a")
    studio.tell(client, LookChange({"mode": "one"}))
    studio.ask(client).result(LONG)
    found = studio.answer(client, Pick(80, 94)).result(LONG)
    assert found["type"] == "picked"
    assert found["what"] == "ground"
    with pytest.raises(ParameterError, match="pixel"):
        studio.answer(client, Pick(80, 96)).result(LONG)


def test_the_tour_is_filmed_while_others_look_on(studio, join, monkeypatch):
    monkeypatch.setattr("viewer.window.answering._FILMED", 6.0)
    client, other = join("a"), join("b")
    told = []
    film = studio.answer(client, Film(), lambda done, of: told.append((done, of)))
    with pytest.raises(ParameterError, match="one film"):
        studio.answer(other, Film()).result(LONG)
    studio.tell(other, Input(1, Held(turn=1.0)))
    frames = 0
    while not film.done():
        studio.ask(other).result(LONG)
        frames += 1
    assert frames > 10
    reply = film.result(LONG)
    path = studio.films / reply["url"].rpartition("/")[2]
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        assert (stream.width, stream.height) == SIZE
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert (len(pictures), len(pictures)) == told[-1]
    assert len(pictures) == pytest.approx(6.0 / 4.0 * 30.0, abs=1)
    assert np.abs(pictures[0].astype(int) - pictures[-1]).mean() > 1.0


def test_a_film_of_somebody_who_leaves_is_given_up(studio, join):
    client, other = join("a"), join("b")
    film = studio.answer(client, Film())
    studio.ask(other).result(LONG)
    studio.leave(client)
    with pytest.raises(StudioClosedError):
        film.result(LONG)
    studio.ask(other)
    names = {path.name for path in studio.films.iterdir()}
    assert all(name.endswith(".mp4") and not name.startswith(".") for name in names)


def test_the_interpreter_is_left_to_others_while_frames_are_drawn(studio, join):
    """A thread that only wants to say something now and then, as a socket's loop does, gets to it within milliseconds."""
    client = join("a")
    studio.tell(client, Input(1, Held(turn=1.0)))
    studio.ask(client).result(LONG)
    stop, late = threading.Event(), []

    def loop():
        while not stop.is_set():
            start = time.perf_counter()
            time.sleep(0.002)
            late.append(time.perf_counter() - start - 0.002)

    thread = threading.Thread(target=loop)
    thread.start()
    for _ in range(20):
        studio.ask(client).result(LONG)
    stop.set()
    thread.join()
    assert np.median(late) < 0.02
    assert sys.getswitchinterval() == pytest.approx(0.005)


def test_closing_tells_all_and_ends_at_once(dataset):
    studio = Studio(dataset.path)
    with studio:
        studio.join("a", SIZE)
        _, waiting = settled(studio, "a")
        answer = studio.answer("a", Film())
        films = studio.films
        start = time.monotonic()
    assert time.monotonic() - start < 5.0
    for future in (waiting, answer):
        with pytest.raises(StudioClosedError):
            future.result(LONG)
    with pytest.raises(StudioClosedError):
        studio.ask("a")
    assert not films.exists()
    assert not studio._thread.is_alive()


def test_a_damaged_cell_is_an_error_of_its_frame_and_not_the_end(dataset, tmp_path, monkeypatch):
    copy = tmp_path / "damaged"
    shutil.copytree(dataset.path, copy)
    with Studio(copy) as studio:
        studio.join("a", SIZE)
        start = Pose(*_split(studio.about()["pose"]))
        entries = {entry.id: entry for entry in open_dataset(dataset.path).manifest.cells}
        first = studio.ask("a").result(LONG).header["cell"]
        cells = [one for one in studio.scene.whereabouts.cells if one.id not in (first, *entries[first].neighbours)]
        away = max(cells, key=lambda one: (one.p[0] - start.eye[0]) ** 2 + (one.p[1] - start.eye[1]) ** 2)
        file = copy / entries[away.id].files.glb.name
        whole = file.read_bytes()
        file.write_bytes(whole[:-1])
        x, y, z = away.reference
        studio.tell("a", PutAt(Pose((x, y, z), 0.0, 0.0)))
        with pytest.raises(DatasetError):
            studio.ask("a").result(LONG)
        studio.tell("a", PutAt(start))
        assert studio.ask("a").result(LONG).header["cell"] == first
        file.write_bytes(whole)
        monkeypatch.setattr("viewer.window.stage._AGAIN", 0.0)
        studio.tell("a", PutAt(Pose((x, y, z), 0.0, 0.0)))
        assert studio.ask("a").result(LONG).header["cell"] == away.id


def _split(pose):
    return tuple(pose[:3]), pose[3], pose[4]


def test_what_cannot_be_shown_is_refused_before_any_thread(tmp_path, single):
    with pytest.raises(DatasetError):
        Studio(tmp_path)
    with pytest.raises(ParameterError, match="several layers"):
        Studio(single.dataset.path)
    for some in ({"sessions": 0}, {"techniques": ()}, {"techniques": ("nothing",)}, {"techniques": ("single-mesh",)}):
        with pytest.raises(ParameterError):
            StudioOptions(**some)


def test_a_dataset_of_single_layers_beside_it(dataset, single):
    with Studio(dataset.path, StudioOptions(single_mesh=single.dataset.path)) as studio:
        assert studio.about()["techniques"][-1] == "single-mesh"
        studio.join("a", SIZE)
        studio.tell("a", LookChange({"mode": "side", "left": "single-mesh"}))
        views = studio.ask("a").result(LONG).header["views"]
        assert [one["technique"] for one in views] == ["single-mesh", "multi-mesh"]
        assert all(one["stored"] > 0 for one in views)


def test_the_map_has_all_buildings_and_cells(studio, join):
    client = join("a")
    found = studio.answer(client, AskMap()).result(LONG)
    assert found["type"] == "map"
    assert {one["id"] for one in found["footprints"]} == set(studio.scene.objects)
    assert {one["id"] for one in found["cells"]} == {cell.id for cell in studio.scene.whereabouts.cells}


def test_the_worst_region_is_told_when_the_viewer_stands(studio, join):
    client = join("a")
    studio.tell(client, LookChange({"mode": "side", "right": "local", "worst": True}))
    shown = studio.ask(client).result(LONG)
    assert shown.header["worst"] is None
    while shown.header["worst"] is None:
        shown = studio.ask(client).result(LONG)
    worst = shown.header["worst"]
    assert shown.header["still"]
    x, y, width, height = worst["box"]
    assert SIZE[0] // 2 <= x < x + width <= SIZE[0]  # in the right one's half
    assert 0 <= y < y + height <= SIZE[1]
    assert worst["thickness_px"] > 5.0  # local leaves out all that is far
    _, waiting = settled(studio, client)
    studio.tell(client, Input(1, Held(), (0.5, 0.0)))
    assert waiting.result(LONG).header["worst"] is None
    studio.tell(client, LookChange({"worst": False}))
    last, _ = settled(studio, client)
    assert last.header["worst"] is None


def test_frames_say_what_is_promised_of_them(studio, join):
    client = join("a", (256, 256))
    shown = studio.ask(client).result(LONG)
    assert shown.header["promised_px"]["displacement"] == pytest.approx(5.0)
    studio.tell(client, LookChange({"fly": True}))
    studio.tell(client, PutAt(Pose((0.0, 0.0, 50.0), 0.0, 0.0)))
    assert studio.ask(client).result(LONG).header["promised_px"] is None
