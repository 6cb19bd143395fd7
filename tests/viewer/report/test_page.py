"""The report, from a fake of what compare-impostors measures."""

import base64
import copy
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from matplotlib import get_data_path
from PIL import Image, ImageFont

import viewer.report.page
from mmi.foundation.errors import DatasetError
from viewer.measuring.summary import settling_summary
from viewer.report.page import write_report
from viewer.report.pictures import save_picture, triptych
from viewer.report.plots import distributions, errors_along_walk, frame_times, settling, technique_color

SCHEMA = json.loads((Path(viewer.report.page.__file__).parent / "schemas" / "report.json").read_text(encoding="utf-8"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)
# frame time, wrong share, thickness: rough sizes of what each technique does
NATURE = {
    "full": (60.0, 0.0, 0.0),
    "visible": (25.0, 1e-6, 1.0),
    "local": (6.0, 0.2, 160.0),
    "single-mesh": (7.5, 0.01, 14.0),
    "multi-mesh": (8.0, 0.003, 3.5),
}
VOID = {"meta", "img"}


def quantiles(values, *names):
    return {name: float(values.max() if name == "max" else np.percentile(values, float(name[1:]))) for name in names}


def technique(name, views, frames, walked):
    thick = np.array([view["wrong_thickness_px"] for view in views])
    moved = np.array([view["displacement_px"] for view in views])
    reference, layered = name == "full", "mesh" in name
    errors = {
        "hole_share": 0.3 * NATURE[name][1],
        "wrong_share": float(np.mean([view["wrong_share"] for view in views])),
        "wrong_thickness_px": quantiles(thick, "p50", "p99", "max"),
        "displacement_px": quantiles(moved, "p50", "p99", "max"),
        "flip": {"mean": NATURE[name][1], "p95": 2 * NATURE[name][1], "masked": 0.41},
        "psnr_db": None if name == "visible" else 34.56,
        "psnr_worst_db": None if name == "visible" else 21.98,
        "ssim": 0.98765,
    }
    return {
        "layered": layered,
        "origin": None,
        **(dict.fromkeys(errors) if reference else errors),
        "settling": None,
        "pop": {"switches": 6, "mean": -0.0012, "max": 0.0345} if walked and layered else None,
        "update_pop": None,
        "frame_ms": quantiles(frames, "p50", "p95", "p99", "max"),
        "gpu_ms": None,
        "late_share": 0.0125,
        "triangles": 1_234_567.8 / (1 + 20 * layered),
        "draws": 3.0 + 24 * layered,
        "requests": 0.0,
        "captured_pixels": 0.0,
        "loading": {
            "seconds_waited": 0.12,
            "frames_waited": 3,
            "bytes_loaded": 98_765_432,
            "largest_cache_bytes": 5_000_000,
        }
        if walked and layered
        else None,
        "movers": None,
        "rays": None,
        "boxes": None,
        "placed": None,
    }


def report_of(walked, *, names=tuple(NATURE), seconds=40.0, title="helsinki"):
    rng = np.random.default_rng(7)
    times = np.arange(0.0, seconds, 1 / 25)
    waves = 1.0 + 0.4 * np.sin(times / 3.0)
    scored, series, techniques, worst = {}, {}, {}, []
    for name in names:
        milliseconds, wrong, thick = NATURE[name]
        scored[name] = [
            {
                "time_s": float(time) if walked else None,
                "wrong_share": float(wrong * rng.uniform(0.2, 2.0)),
                "wrong_thickness_px": float(np.round(thick * rng.uniform(0.3, 1.8), 1)),
                "displacement_px": float(thick * rng.uniform(0.3, 1.2)),
                "flip_mean": None if name == "visible" else float(wrong * 0.7),
                "psnr_db": None if name == "visible" else 31.5,
                "frames": None,
                "layers": None if walked else 4,
            }
            for time in times[::25]
        ]
        frames = milliseconds * waves * rng.gamma(30.0, 1 / 30.0, len(times))
        layered = "mesh" in name
        series[name] = {
            "time_s": times.tolist(),
            "frame_ms": frames.tolist(),
            "cell": [f"c{i // 150}" if layered else None for i in range(len(times))],
            "switch": list(range(150, len(times), 150)) if layered else [],
        }
        techniques[name] = technique(name, scored[name], frames, walked)
        for rank in (1, 2) if layered else ():
            view = sorted(scored[name], key=lambda one: -one["wrong_thickness_px"])[rank - 1]
            place = {"cell": None if rank == 2 else "w12-3", "eye": [12.3, -45.6, 1.7], "azimuth_deg": -30.0}
            more = {"pitch_deg": 5.0, "hole_share": 0.001, "picture": f"worst/{name}-0{rank}.png"}
            view = {key: value for key, value in view.items() if key not in ("psnr_db", "frames", "layers")}
            worst.append({"technique": name, "rank": rank, **view, **place, **more})
    walk = {
        "name": "Kruununhaka",
        "seconds": seconds,
        "metres": 1234.5,
        "frames": len(times),
        "frames_per_second": 25.0,
    }
    rate = {name: 1.0 / techniques[name]["frame_ms"]["p50"] for name in techniques}
    return {
        "format_version": 7,
        "program": "compare-impostors",
        "source": {
            "kind": "dataset",
            "name": title,
            "city": "helsinki.osm.pbf",
            "cells": 321,
            "built_for": {"width": 512, "height": 512, "fov_deg": 60.0, "max_error_px": 5.0},
            "max_error_px": 5.0,
            "promised_px": 7.0,
            "promising_cells": 300,
        },
        "verdict": {
            "kept": True,
            "views": 20,
            "broken": 0,
            "other_views": 0,
            "thickness_px": 6.0,
            "displacement_px": 4.1,
            "why": None,
            "line": "promise kept: worst region 6 px (T + 2 = 7), displacement 4.1 px (T = 5), 20 views",
        },
        "device": "llvmpipe (LLVM 15.0.6, 256 bits)",
        "display": {"width": 512, "height": 512, "fov_deg": 60.0},
        "reference": "full",
        "mode": "tour" if walked else "views",
        "views": len(times[::25]),
        "seed": None if walked else 3,
        "held_frames": None if walked else 1,
        "frames_per_second": 25.0,
        "budget_ms": None,
        "movers": None,
        "walk": {**walk, "legs": 1} if walked else None,
        "techniques": techniques,
        "ratios": {
            name: {other: rate[name] / rate[other] if other in rate else None for other in ("full", "visible", "local")}
            for name in techniques
        },
        "series": series if walked else None,
        "scored": {name: some for name, some in scored.items() if name != "full"},
        "worst": worst,
        "videos": ["walk.mp4", "walk 2.webp"] if walked else [],
    }


def hold(report, frames=16):
    """Let the views of a fake report have been held. Those of multi-mesh settle after 0, 1, ... frames, others at once."""
    report["held_frames"], report["budget_ms"] = frames, 5.0
    for name, views in report["scored"].items():
        for i, view in enumerate(views):
            view["frames"] = 0 if name != "multi-mesh" else i % (frames + 4)
            view["frames"] = None if view["frames"] >= frames else view["frames"]
            view["layers"] = 2 + i % 9
        settled = [view["frames"] for view in views]
        summary = settling_summary(settled, settled, [view["layers"] for view in views], held=frames)
        report["techniques"][name]["settling"] = summary
    return report


def street(size=512):
    """A picture of a street, roughly; the same with a facade that is displaced; wrong pixels and holes."""
    y, x = np.mgrid[:size, :size]
    truth = np.zeros((size, size, 3), dtype=np.uint8)
    truth[:] = np.stack([120 + y // 6, 160 + y // 8, 210 + 0 * x], axis=-1)
    truth[y > 0.55 * size] = (110, 108, 104)
    left = (x < 0.36 * size) & (np.abs(y - 0.55 * size) < 0.95 * (0.42 * size - x) + 0.05 * size)
    truth[left] = (176, 142, 110)
    truth[left & (x % 24 > 12) & (y % 30 > 16)] = (60, 70, 84)
    far = (x > 0.6 * size) & (x < 0.8 * size) & (y > 0.3 * size) & (y < 0.56 * size)
    truth[far] = (150, 96, 84)
    moved = np.roll(far, 6, axis=1)
    shown = truth.copy()
    shown[far & ~moved] = (140, 180, 215)
    shown[moved & ~far] = (150, 96, 84)
    wrong = far ^ moved
    wrong[40, 60] = True
    return truth, shown, wrong, far & ~moved


def pictures(report, folder):
    for view in report["worst"]:
        save_picture(
            folder / view["picture"], triptych(*street(), titles=("geometry", view["technique"], "what is wrong"))
        )


class Page(HTMLParser):
    """Tags, texts and links of a page; complains about elements that are not closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.texts, self.links = [], [], [], []
        self.rows = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)
        if self.open and self.rows and ("td" in self.open or "th" in self.open):
            self.rows[-1][-1] += data

    @property
    def text(self):
        return " ".join("".join(self.texts).split())


def page_of(report, folder):
    pictures(report, folder)
    return Page(write_report(report, folder)[1].read_text(encoding="utf-8"))


def row(page, name, table):
    """Texts of the rows of a technique: tables 0 and 1 together have the errors, 2 and 3 the speed."""
    left, right = [one for one in page.rows if one[0] == name][2 * table : 2 * table + 2]
    return [*left, *right[1:]]


@pytest.mark.parametrize("walked", [True, False])
def test_the_json_is_the_report_and_as_described(tmp_path, walked):
    report = report_of(walked)
    pictures(report, tmp_path)
    paths = write_report(report, tmp_path)
    assert paths == (tmp_path / "report.json", tmp_path / "report.html")
    assert json.loads(paths[0].read_bytes()) == report
    assert list(VALIDATOR.iter_errors(report)) == []
    assert sorted(one.name for one in tmp_path.iterdir()) == ["report.html", "report.json", "worst"]


def test_the_same_report_gives_the_same_bytes(tmp_path):
    report = report_of(True, seconds=8.0)
    for name in "ab":
        pictures(report, tmp_path / name)
        write_report(copy.deepcopy(report), tmp_path / name)
    for name in ("report.json", "report.html"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_page_needs_nothing_but_its_videos(tmp_path):
    page = page_of(report_of(True), tmp_path)
    inside = [link for link in page.links if link.startswith("data:image/")]
    assert len(inside) == 3 + 4  # diagrams and worst views
    for link in inside:
        kind, data = re.fullmatch(r"data:image/(\w+);base64,(.*)", link).groups()
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            assert image.format == kind.upper()
            assert image.width <= 1600
    outside = {link for link in page.links if not link.startswith("data:")}
    worst = {f"./worst/{name}-0{i}.png" for name in ("single-mesh", "multi-mesh") for i in (1, 2)}
    assert outside == worst | {"./walk.mp4", "./walk%202.webp"}
    assert "script" not in page.tags
    assert page.tags.count("video") == 1


def test_the_page_says_what_was_compared(tmp_path):
    text = page_of(report_of(False), tmp_path).text
    sentence = (
        "compares visible, local, single-mesh and multi-mesh with full, which draws all of the geometry, in 40 views"
    )
    assert sentence in text
    for part in (
        "seed 3",
        "512 × 512 pixels",
        "60°",
        "llvmpipe (LLVM 15.0.6, 256 bits)",
        "helsinki.osm.pbf",
        "321 cells",
    ):
        assert part in text
    assert (
        "thicker than 7 px (2 px for the rasters of geometry and textures) in 300 of the 321 cells; it promises" in text
    )
    walk = page_of(report_of(True, names=("full", "local")), tmp_path).text
    assert "in 40 views along a tour (Kruununhaka: 1000 frames, 1,234 m in 40 s, 1 leg)" in walk


def test_tables_hold_the_numbers_and_mark_what_breaks_the_promise(tmp_path):
    report = report_of(True)
    errors = report["techniques"]["multi-mesh"]
    errors["wrong_share"], errors["hole_share"] = 0.00123456, 0.0000000123
    errors["wrong_thickness_px"] = {"p50": 2.0, "p99": 7.0, "max": 7.01}
    errors["displacement_px"] = {"p50": 0.5, "p99": 4.25, "max": 123456.0}
    page = page_of(report, tmp_path)
    expected = [
        "multi-mesh",
        "0.123",
        "<0.001",
        "2",
        "7",
        "▲ 7.01",
        "0.5",
        "4.25",
        "123,456",
        "0.0030",
        "0.0060",
        "0.4100",
    ]
    assert row(page, "multi-mesh", 0) == [*expected, "34.6", "22.0", "0.9877", "6", "−0.0012", "0.0345"]
    assert row(page, "visible", 0)[9:] == [
        "0.0000",
        "0.0000",
        "0.4100",
        "identical",
        "identical",
        "0.9877",
        "–",
        "–",
        "–",
    ]
    assert row(page, "full", 0) == ["full", *2 * ["what the others are compared with"]]
    speed = row(page, "multi-mesh", 1)
    ratios = report["ratios"]["multi-mesh"]
    assert speed[8:10] == ["58,789", "27"]
    assert speed[5:8] == [f"{ratios[other]:.3g}×" for other in ("full", "visible", "local")]
    assert speed[10:] == ["1.25", "0.12", "3", "98.8", "5"]


def test_groups_without_any_value_are_left_out_and_techniques_that_were_not_run_have_no_ratio(tmp_path):
    walked, sampled = page_of(report_of(True), tmp_path), page_of(report_of(False), tmp_path)
    assert "pop, FLIP" in walked.texts
    assert "pop, FLIP" not in sampled.texts
    assert "waiting for cells" not in sampled.texts
    assert [len(one) for one in sampled.rows if one[0] == "local"] == [1 + 8, 1 + 6, 1 + 7, 1 + 3]
    assert "settled after, frames" not in sampled.texts
    few = page_of(report_of(False, names=("full", "multi-mesh")), tmp_path)
    assert row(few, "multi-mesh", 1)[6:8] == ["–", "–"]


def test_views_that_were_held_have_a_table_and_a_diagram_of_when_they_settled(tmp_path):
    report = hold(report_of(False))
    assert list(VALIDATOR.iter_errors(report)) == []
    page = page_of(report, tmp_path)
    found = report["techniques"]["multi-mesh"]["settling"]
    assert found["unsettled"] == 8, "16 to 19 frames, twice in 40 views"
    shown = [found["alike_frames"][key] for key in ("p50", "p99", "max")]
    shown += [found["unlike"], found["later_than_layers"]]
    shown += [found["settled_frames"][key] for key in ("p50", "p99", "max")]
    shown += [found["unsettled"], found["layers"]["p50"], found["layers"]["max"]]
    third = [one for one in page.rows if one[0] == "multi-mesh"][2]
    assert third[1:] == [f"{one:.3g}" for one in shown]
    assert (
        ", each of them held for 16 frames before it is scored, with at most 5 ms of a frame for updates and rays, at"
        in page.text
    )
    assert "Each view was held for 16 frames, and the times of all of them count" in page.text
    assert "The share of views that were like the geometry after so many frames" in page.text
    assert "The share of views that were like" not in page_of(report_of(False), tmp_path).text


def test_what_moved_has_a_table_and_is_said(tmp_path):
    report = report_of(True)
    report["movers"] = {
        "source": "cars & vans.json",
        "objects": 300,
        "max_error_px": 1.0,
        "calculation": "predictive",
        "time_s": None,
    }
    for name, entry in report["techniques"].items():
        some = {"geometry": 2.5, "captured": 3.25, "reused": 120.0, "hidden": 7.0, "valid_frames": 20.5}
        none = {"geometry": 125.75, "captured": 0.0, "reused": 0.0, "hidden": 0.0, "valid_frames": None}
        entry["movers"] = some if "mesh" in name else none
    assert list(VALIDATOR.iter_errors(report)) == []
    page = page_of(report, tmp_path)
    assert "among 300 moving objects (cars & vans.json)" in page.text
    assert [one for one in page.rows if one[0] == "multi-mesh"][-1][1:] == ["2.5", "3.25", "120", "7", "20.5"]
    assert [one for one in page.rows if one[0] == "full"][-1][1:] == ["126", "0", "0", "0", "–"]
    assert "The image of one is captured, moves with it" in page.text
    still = page_of(report_of(True), tmp_path)
    assert "moving objects" not in still.text
    assert "The image of one is captured" not in still.text


def test_the_diagram_of_settling_counts_views_that_have_not_settled_as_never_settling():
    views = [{"frames": after, "layers": layers} for after, layers in ((0, 1), (2, 1), (2, 5), (None, 5), (7, 4))]
    [axes] = settling({"multi-mesh": views}, held=8).axes
    x, y = lines(axes)[technique_color("multi-mesh")]
    for frames, share in ((0.0, 20.0), (1.9, 20.0), (2.0, 60.0), (6.9, 60.0), (7.0, 80.0), (8.0, 80.0)):
        assert y[x <= frames][-1] == pytest.approx(share)
    [layers] = [line for line in axes.lines if line.get_linestyle() == "--"]
    x, y = map(np.asarray, layers.get_data())
    for count, share in ((0.9, 0.0), (1.0, 40.0), (4.0, 60.0), (5.0, 100.0), (8.0, 100.0)):
        assert y[x <= count][-1] == pytest.approx(share)
    none = settling({"multi-mesh": [{"frames": None, "layers": 0}]}, held=8)
    assert lines(none.axes[0])[technique_color("multi-mesh")][1].max() == 0.0


def test_what_is_captured_is_shown_where_a_technique_captures_something(tmp_path):
    report = report_of(False)
    assert "captured a frame" not in page_of(report, tmp_path).texts
    report["techniques"]["multi-mesh"] |= {"requests": 1.25, "captured_pixels": 32_768.0}
    page = page_of(report, tmp_path)
    assert "captured a frame" in page.texts
    assert row(page, "multi-mesh", 1)[8:] == ["58,789", "27", "1.25", "32,768", "1.25"]
    assert row(page, "local", 1)[10:] == ["0", "0", "1.25"]


def test_only_terms_whose_columns_are_there_are_explained(tmp_path):
    def terms(report):
        text = "".join(write_report(report, tmp_path)[1].read_text(encoding="utf-8"))
        return re.findall(r"<dt>(.*?)</dt>", text)

    report = {**report_of(True, seconds=4.0), "worst": []}
    everything = ["wrong", "holes", "thickness", "displacement", "FLIP", "PSNR, SSIM", "pop", "p50, p95, p99", "late"]
    assert terms(report) == everything
    assert terms({**report_of(False), "worst": []}) == [term for term in everything if term != "pop"]
    for one in report["techniques"].values():
        one["flip"] = one["pop"] = None
    assert terms(report) == [term for term in everything if term not in ("FLIP", "pop")]
    held = terms({**hold(report_of(False)), "worst": []})
    assert held[-4:] == ["settled", "layers", "p50, p95, p99", "late"]
    alone = {**report_of(False, names=("full",)), "worst": []}
    assert terms(alone) == ["late"]
    capturing = {**report_of(True, seconds=4.0), "worst": []}
    capturing["techniques"]["multi-mesh"]["update_pop"] = {"frames": 40, "mean": -0.0012, "max": 0.0123}
    capturing["techniques"]["multi-mesh"]["requests"] = 0.125
    assert terms(capturing) == [*everything[:-2], "pop of updates", *everything[-2:], "captured"]
    assert "−0.0012" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_no_table_is_wider_than_a_window_of_1000_pixels(tmp_path):
    """In DejaVu Sans, wider than most fonts, in 13 pixels as the page has it: a browser agrees to within a few pixels."""
    report = hold(report_of(True, seconds=8.0))
    for one in report["techniques"].values():
        one["gpu_ms"] = one["frame_ms"]
        one |= {"requests": 12.25, "captured_pixels": 262_144.0}
        one["update_pop"] = {"frames": 1234, "mean": -0.0123, "max": 0.1234}
    font = ImageFont.truetype(get_data_path() + "/fonts/ttf/DejaVuSans-Bold.ttf", 13)
    rows = [*page_of(report, tmp_path).rows, ["", "end"]]
    tables, rest = [], []
    for row in rows:
        if row[0] == "" and rest and rest[-1][0] != "":  # the headings of the next table
            tables.append([one for one in rest if len(one) == max(map(len, rest))])
            rest = []
        rest.append(row)
    assert len(tables) == 5
    for table in tables:
        texts = [max(map(font.getlength, column)) for column in zip(*table, strict=True)]
        assert sum(texts) + 14.4 * len(texts) + 18.4 < 1000 - 32, "padding, and the technique's colour"


def test_a_dataset_that_promises_nothing_is_said_to_promise_nothing(tmp_path):
    report = report_of(True)
    report["source"] |= {"promised_px": None, "promising_cells": 0}
    assert list(VALIDATOR.iter_errors(report)) == []
    text = page_of(report, tmp_path).text
    assert "an error of 5 px, but none of the cells promises to keep to it" in text
    assert "thicker than" not in text
    assert "▲" not in text


def test_worst_views_come_by_technique_and_rank_with_place_and_numbers(tmp_path):
    report = report_of(True)
    report["worst"].reverse()
    text = page_of(report, tmp_path).text
    titles = [f"{name}, number {i}: " for name in ("single-mesh", "multi-mesh") for i in (1, 2)]
    assert sorted(text.index(title) for title in titles) == [text.index(title) for title in titles]
    assert "multi-mesh, number 1: cell w12-3" in text
    assert "multi-mesh, number 2: outside all cells" in text
    assert "eye at (12.30, −45.60, 1.70) m; azimuth −30.0°, pitch 5.0°" in text
    thickest = report["worst"][-1]["wrong_thickness_px"]
    assert thickest > 7.0
    assert f"▲ {thickest:.3g} px thick" in text


def test_worst_views_of_layered_techniques_stand_before_those_of_geometry(tmp_path):
    """Geometry alone is always wrong the most, and says nothing about impostors."""
    report = report_of(True)
    report["worst"].insert(0, {**report["worst"][0], "technique": "local", "picture": "worst/local-01.png"})
    text = page_of(report, tmp_path).text
    titles = ["single-mesh, number 1", "multi-mesh, number 1", "multi-mesh, number 2", "local, number 1"]
    assert sorted(text.index(title) for title in titles) == [text.index(title) for title in titles]


def test_names_are_text_whatever_they_hold(tmp_path):
    evil = "<script>alert('&\"1\"')</script>"
    report = report_of(True, title=evil)
    report["source"]["city"] = report["device"] = report["walk"]["name"] = report["worst"][0]["cell"] = evil
    report["videos"] = [evil, f"{evil}.webp"]
    report["techniques"][evil] = report["techniques"]["multi-mesh"]
    report["series"][evil] = report["series"]["multi-mesh"]
    report["scored"][evil] = report["scored"]["multi-mesh"]
    report["worst"].append({**report["worst"][0], "technique": evil})
    page = page_of(report, tmp_path)
    assert "script" not in page.tags
    assert page.text.count(evil) == 16
    assert Page((tmp_path / "report.html").read_text(encoding="utf-8")).tags.count("video") == 1


def test_a_reference_alone_can_be_reported(tmp_path):
    for walked in (True, False):
        report = report_of(walked, names=("full",), seconds=0.04)
        assert list(VALIDATOR.iter_errors(report)) == []
        assert "compares nothing with full" in page_of(report, tmp_path).text


def test_missing_pictures_and_folders_that_cannot_be_written_are_named(tmp_path):
    report = report_of(False)
    first = re.escape(str(tmp_path / "worst" / "single-mesh-01.png"))
    with pytest.raises(DatasetError, match=f"{first}: a picture expected, found: No such file"):
        write_report(report, tmp_path)
    (tmp_path / "worst").mkdir()
    (tmp_path / "worst" / "single-mesh-01.png").write_bytes(b"no picture")
    with pytest.raises(DatasetError, match=f"{first}: a picture expected, found: cannot identify"):
        write_report(report, tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["worst"]
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(DatasetError, match=f"{tmp_path}/file/report.json: a writable file expected"):
        write_report({**report, "worst": []}, tmp_path / "file")


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    report = report_of(False)
    report["worst"] = []
    report["techniques"]["full"]["psnr_db"] = float("inf")
    with pytest.raises(ValueError, match="JSON"):
        write_report(report, tmp_path)
    assert list(tmp_path.iterdir()) == []


def lines(axes):
    """{colour: (x, y)} of the lines of a diagram, without the dashed one of the promise."""
    return {
        line.get_color(): tuple(map(np.asarray, line.get_data())) for line in axes.lines if line.get_linestyle() == "-"
    }


def test_diagrams_hold_every_technique_in_its_colour():
    report = report_of(True)
    colors = {technique_color(name) for name in NATURE}
    assert len(colors) == len(NATURE)
    above, marks = frame_times(report["series"]).axes
    assert set(lines(above)) == colors
    x, y = lines(above)[technique_color("multi-mesh")]
    assert np.array_equal(x, report["series"]["multi-mesh"]["time_s"])
    assert np.array_equal(y, report["series"]["multi-mesh"]["frame_ms"])
    assert marks.collections[1].get_positions() == pytest.approx([6.0, 12.0, 18.0, 24.0, 30.0, 36.0])
    assert [label.get_text() for label in marks.get_yticklabels()] == ["single-mesh", "multi-mesh"]
    above, below = errors_along_walk(report["scored"], promise_px=7.0).axes
    shares = [100.0 * view["wrong_share"] for view in report["scored"]["local"]]
    assert np.allclose(lines(below)[technique_color("local")][1], shares)
    assert above.get_ylim()[1] > max(view["wrong_thickness_px"] for view in report["scored"]["local"])
    assert set(lines(above)) == set(lines(below)) == colors - {technique_color("full")}


def test_diagrams_of_datasets_that_promise_nothing_mark_no_promise():
    scored = report_of(True)["scored"]
    for plot in (errors_along_walk, distributions):
        for promise, marks in ((7.0, 1), (None, 0)):
            axes = plot(scored, promise_px=promise).axes[0]
            assert sum(line.get_linestyle() == "--" for line in axes.lines) == marks
            assert [text.get_text() for text in axes.texts] == ["promise"] * marks


def test_the_word_promise_covers_no_line_and_is_not_cut():
    scored = report_of(True)["scored"]
    for plot in (errors_along_walk, distributions):
        figure = plot(scored, promise_px=12.0)
        figure.canvas.draw()
        word = figure.axes[0].texts[0].get_window_extent()
        assert not any(word.overlaps(axes.get_window_extent()) for axes in figure.axes)
        assert figure.bbox.x0 <= word.x0 and word.x1 <= figure.bbox.x1 and word.y1 <= figure.bbox.y1


def test_distributions_count_the_views_that_have_no_more():
    views = [{"wrong_thickness_px": float(t), "wrong_share": 0.001 * t} for t in (4, 0, 2, 2, 10)]
    left, right = distributions({"multi-mesh": views}, promise_px=7.0).axes
    for axes, scale in ((left, 1.0), (right, 0.1)):
        x, y = lines(axes)[technique_color("multi-mesh")]
        for value, share in (
            (0.0, 20.0),
            (1.9, 20.0),
            (2.0, 60.0),
            (4.0, 80.0),
            (9.9, 80.0),
            (10.0, 100.0),
            (11.0, 100.0),
        ):
            assert y[x <= value * scale + 1e-9][-1] == pytest.approx(share)
        assert x[-1] == axes.get_xlim()[1]


# The schema, as tests/mmi/test_schemas.py holds those of a dataset.


def objects(value, at=()):
    """The way to every JSON object in ``value``, itself included; of a list only to the first that holds anything."""
    if isinstance(value, dict):
        yield at
        for key, one in value.items():
            yield from objects(one, (*at, key))
    elif isinstance(value, list) and any(value):
        first = next(i for i, one in enumerate(value) if one)
        yield from objects(value[first], (*at, first))


def changed(report, way, change):
    other = copy.deepcopy(report)
    part = other
    for key in way:
        part = part[key]
    change(part)
    return other


NAMED = {("techniques",), ("ratios",), ("series",), ("scored",)}


def test_every_field_is_wanted_and_no_other_is_let_in():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    report = report_of(True, names=("full", "multi-mesh"), seconds=8.0)
    report["techniques"]["multi-mesh"] |= {
        "origin": {"function": "my_module:mine", "version": "1"},
        "settling": settling_summary([0, None], [0, None], [3, 4], held=8),
        "update_pop": {"frames": 40, "mean": 0.0012, "max": 0.0123},
    }
    for way in objects(report):
        part = report
        for key in way:
            part = part[key]
        assert not VALIDATOR.is_valid(changed(report, way, lambda one: one.update(another=1.5))), way
        for key in () if way in NAMED else part:
            assert not VALIDATOR.is_valid(changed(report, way, lambda one, key=key: one.pop(key))), (*way, key)
            assert not VALIDATOR.is_valid(changed(report, way, lambda one, key=key: one.update({key: [[]]}))), (
                *way,
                key,
            )


def test_every_field_is_described():
    def undescribed(one, way):
        for key, value in one.get("properties", {}).items():
            target = SCHEMA["$defs"][value["$ref"].rsplit("/", 1)[1]] if "$ref" in value else value
            if not (value.get("description") or target.get("description")):
                yield (*way, key)
            yield from undescribed(value, (*way, key))
        for key in ("items", "additionalProperties"):
            if isinstance(one.get(key), dict):
                yield from undescribed(one[key], (*way, key))

    parts = {"report": SCHEMA, **SCHEMA["$defs"]}
    assert [way for key, one in parts.items() for way in undescribed(one, (key,))] == []


@pytest.mark.parametrize(("most", "reuse"), [(None, "bound"), (1500, "hits")])
def test_the_rules_of_rays_are_told_where_some_were_cast(tmp_path, most, reuse):
    report = report_of(False)
    assert "Rays find" not in page_of(report, tmp_path).text
    shares = ("covered", "sky", "reused", "hit", "missed", "late", "unknown")
    report["techniques"]["local"]["rays"] = {
        "near_field_m": 30.0,
        "caster": "grid",
        "reuse": reuse,
        "reuse_error_px": 2.5,
        "most": most,
        "cast": 812.0,
        "kept_px": 2.25,
        **{f"{share}_share": 0.125 for share in shares},
    }
    assert list(VALIDATOR.iter_errors(report)) == []
    text = page_of(report, tmp_path).text
    limited = ", at most 1500 rays a frame" if most else ""
    assert f"Rays find what is farther away than 30 m (grid{limited})." in text
    known = "a bound for all that is far" if reuse == "bound" else "a measurement of each surface that was hit"
    assert f"shown again while it is off by 2.5 px at most ({known})." in text
