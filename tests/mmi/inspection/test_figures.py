"""Files of figures: each format is what its name says, holds no date, and comes out the same byte for byte."""

import io
import os
import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from mmi.foundation.errors import DatasetError, ParameterError
from mmi.inspection.figures import PICTURE_FORMATS, encoded, layer_style, new_figure, save

SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
from test_figures import diagram
from mmi.inspection.figures import encoded
sys.stdout.buffer.write(encoded(diagram(), sys.argv[1]))
"""


def diagram():
    """What formats store differently: text of several scripts, hatches, a clipped line, an image."""
    figure = new_figure(4.0, 3.0)
    axes = figure.add_subplot()
    axes.bar([0, 1, 2], [3, 1, 2], color="#56B4E9", hatch=layer_style(8)[1])
    axes.plot([-5.0, 9.0], [0.0, 4.0])
    axes.imshow(np.arange(12).reshape(3, 4), extent=(0.0, 1.0, 0.0, 1.0))
    axes.set_title("Žižkov, \u6771\u4eac", loc="left")
    return figure


@pytest.mark.parametrize("form", PICTURE_FORMATS)
def test_another_process_on_another_day_writes_the_same_bytes(form, tmp_path):
    script = tmp_path / "draw.py"
    script.write_text(SCRIPT.format(tests=os.path.dirname(__file__)))  # noqa: PTH120
    environment = os.environ | {"SOURCE_DATE_EPOCH": "86400", "PYTHONHASHSEED": "12", "PYTHONPATH": os.getcwd()}  # noqa: PTH109
    other = subprocess.run([sys.executable, script, form], capture_output=True, check=True, env=environment).stdout
    assert encoded(diagram(), form) == other


def test_a_file_is_what_its_name_says(tmp_path):
    for form in PICTURE_FORMATS:
        save(diagram(), tmp_path / f"a.{form}")
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (600, 450)
    assert ElementTree.parse(tmp_path / "a.svg").getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert (tmp_path / "a.pdf").read_bytes()[:5] == b"%PDF-"
    assert (tmp_path / "a.svg").read_text().count("<text") == 0, "text is outlines: no font is needed"
    for form in PICTURE_FORMATS:
        assert not re.search(rb"dc:date|CreationDate|ModDate|tIME", (tmp_path / f"a.{form}").read_bytes())


def test_a_figure_is_written_again_in_another_format():
    figure = diagram()
    first = encoded(figure)
    encoded(figure, "svg"), encoded(figure, "pdf")
    assert encoded(figure) == first
    with Image.open(io.BytesIO(first)) as picture:
        assert np.asarray(picture.convert("L")).std() > 20.0


@pytest.mark.parametrize("name", ["a.gif", "a", "a.PNG"])
def test_other_endings_are_refused(tmp_path, name):
    with pytest.raises(ParameterError, match="format: png, svg, pdf expected, found"):
        save(new_figure(1.0, 1.0), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_picture_is_whole_or_not_there(tmp_path, monkeypatch):
    figure = new_figure(1.0, 1.0)
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match=r"file/a\.png: a writable file expected"):
        save(figure, tmp_path / "file" / "a.png")
    save(figure, tmp_path / "a.png")
    before = (tmp_path / "a.png").read_bytes()

    def broken(file, **_):
        file.write(b"half a picture")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure, "savefig", broken)
    with pytest.raises(OSError, match="No space"):
        save(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes() == before and len(list(tmp_path.iterdir())) == 2
