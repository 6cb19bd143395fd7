"""What libraries are told when a program starts, and memory that is given back."""

import os
import platform
from pathlib import Path

import pytest

from mmi.foundation.processes import give_memory_back, quiet_libraries


def held() -> int:
    """Bytes of memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="others give memory back by themselves, or never")
def test_what_was_freed_is_given_back():
    """One small thing at the end keeps all before it with glibc."""
    things = [bytes(2000) for _ in range(60_000)]
    full = held()
    del things[:-1]
    give_memory_back()
    assert held() < full - 60_000_000
    assert len(things) == 1


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
