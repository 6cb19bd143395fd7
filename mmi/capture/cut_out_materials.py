"""How pyrender draws cut-outs: fragments that are clear (``mmi.appearance.cut_outs``) leave neither colour nor depth.

pyrender's own materials have no such test, and its textures let OpenGL make their levels, where here they are the ones that
the viewer and rays take as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.shader_program import ShaderProgram, ShaderProgramCache

from mmi.appearance.city_mesh import CityMesh
from mmi.appearance.cut_outs import ClearBlocks, cut_out_triangles, texture_levels

__all__ = ["CutOutPrograms", "SharperTexture", "cut_out_coordinates"]

_SHARPER = -0.75  # mipmap levels: facades are seen at grazing angles, where trilinear filtering blurs their windows
_FRAGMENT = """#version 330 core
struct Material { vec4 base_color_factor; sampler2D base_color_texture; };
uniform Material material;
in vec2 uv_0; in vec2 uv_1; in vec4 color_multiplier;
out vec4 frag_color;
void main() {
    vec4 texel = texture(material.base_color_texture, uv_0);
    if (max(texel.a, uv_1.x) < 0.5) discard;
    frag_color = vec4(mix(texel.rgb, vec3(1.0), uv_1.y), 1.0) * color_multiplier;
}
"""


def cut_out_coordinates(part: CityMesh, clear: ClearBlocks, *, plain: bool) -> NDArray[np.float32]:
    """(n, 2) the ``texcoord_1`` of a mesh: is a vertex solid whatever its alpha, and ``plain``: its colour counts alone."""
    found = np.ones((len(part.uv), 2), dtype=np.float32)
    found[part.triangles[cut_out_triangles(clear, part.uv, part.triangles)], 0] = 0.0
    found[:, 1] = plain
    return found


class SharperTexture(pyrender.Texture):
    """Filters trilinearly, from a finer mipmap; a texture (h, w, 4) has the levels of ``mmi.appearance.cut_outs``.

    Anisotropic filtering would do better, but in software (Mesa 22) a wall seen edge-on takes it minutes.
    """

    def _add_to_context(self) -> None:
        super()._add_to_context()
        GL.glBindTexture(self.tex_type, self._texid)
        GL.glTexParameterf(self.tex_type, GL.GL_TEXTURE_LOD_BIAS, _SHARPER)
        if self.source_channels == "RGBA":
            for k, level in enumerate(texture_levels(self.source)[1:], 1):
                turned = np.ascontiguousarray(level[::-1])
                GL.glTexSubImage2D(self.tex_type, k, 0, 0, *level.shape[1::-1], GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, turned)
        GL.glBindTexture(self.tex_type, 0)


class CutOutPrograms(ShaderProgramCache):
    """pyrender's programs of one context; primitives with a ``texcoord_1`` get one that leaves out what is clear."""

    def __init__(self) -> None:
        super().__init__()
        self._own: ShaderProgram | None = None

    def get_program(
        self,
        vertex_shader: str,
        fragment_shader: str,
        geometry_shader: str | None = None,
        defines: dict[str, int] | None = None,
    ) -> Any:  # noqa: ANN401
        """The program of these shaders, made once."""
        if "TEXCOORD_1_LOC" not in (defines or {}):
            return super().get_program(vertex_shader, fragment_shader, geometry_shader, defines)
        if self._own is None:
            paths = (str(Path(self.shader_dir) / name) for name in (vertex_shader, fragment_shader))
            self._own = _CutOutProgram(*paths, defines=defines)
        return self._own

    def clear(self) -> None:
        """Free them all."""
        super().clear()
        if self._own is not None:
            self._own.delete()
        self._own = None


class _CutOutProgram(ShaderProgram):
    """pyrender's program for flat shading, with a fragment shader of ours."""

    def _load(self, shader_filename: str) -> str:
        return _FRAGMENT if shader_filename == self.fragment_shader else str(super()._load(shader_filename))
