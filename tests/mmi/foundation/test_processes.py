"""What libraries are told when a program starts."""

import os

import pytest

from mmi.foundation.processes import quiet_libraries


@pytest.mark.parametrize(
    ("place", "kept"), [("", True), ("new", True), ("file", False), ("file/new", False), ("no/new", False)]
)
def test_mesa_keeps_shaders_where_it_can(monkeypatch, tmp_path, place, kept):
    """It complains on standard error where it cannot."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("MESA_SHADER_CACHE_DISABLE", "")
    monkeypatch.delenv("MESA_SHADER_CACHE_DISABLE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / place))
    quiet_libraries()()
    assert ("MESA_SHADER_CACHE_DISABLE" not in os.environ) == kept
