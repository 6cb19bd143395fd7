"""Edges of meshes as lines over a picture that is darkened for them, a little nearer than the surfaces that they bound.

Surfaces do not hide their own edges so, but those behind them. Lines belong to no measured picture: they are drawn into its
colours, and what it measures is what it would be without them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import moderngl

from viewer.drawing.programs import MODES, SCREEN_VERTEX, Program, Programs, ink_bytes
from viewer.drawing.style import Ink
from viewer.drawing.targets import Targets

__all__ = ["LINES", "LineProgram"]

_Vertices = tuple[Any, str]
LINES = "LINES"
"""The flag of programs that draw lines, for which the head has ``project_line``."""
_VERTEX = """
in vec3 position;
#ifdef INKED
in vec4 ink;
#else
uniform vec4 ink;
#endif
flat out vec4 paint;
void main() {
    paint = ink;
    gl_Position = project_line(eye_from_world * (position - eye));
}
"""
_VEIL = "void main() { color_out = vec4(0.05, 0.06, 0.08, 0.55); }"
_FRAGMENT = """
flat in vec4 paint;
void main() { color_out = vec4(mix(paint.rgb, vec3(1.0), 0.15), 1.0); }
"""


class LineProgram:
    """What draws edges of triangles whose vertices have a position in the world. Nothing is compiled before the first draw."""

    def __init__(self, programs: Programs) -> None:
        self._programs = programs
        self._made: dict[bool, Mapping[bool, Program]] = {}
        self._veil: dict[bool, Any] = {}

    @contextmanager
    def over(self, targets: Targets, *, measured: bool) -> Iterator[None]:
        """Darken the picture that is there now; within it, triangles that are drawn are drawn as their edges."""
        context = self._programs.context
        targets.use_lines(measured=measured)
        if not self._veil:
            made = self._programs.make(SCREEN_VERTEX, _VEIL, measures=False)
            self._veil |= {mode: context.vertex_array(made[mode].program, []) for mode in MODES}
        context.enable_only(moderngl.BLEND)
        context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        self._veil[measured].render(moderngl.TRIANGLES, vertices=3)
        context.enable_only(moderngl.DEPTH_TEST)
        context.wireframe = True
        try:
            yield
        finally:
            context.wireframe = False

    def draw(self, vertices: _Vertices, indices: Any, ink: Ink, *, measured: bool) -> None:  # noqa: ANN401
        """Draw the edges of the triangles of ``indices``; ``vertices`` is their buffer, and its format as to positions."""
        program = self._program(measured=measured, inked=False)
        program.set({"ink": ink_bytes(ink)})
        self._render(program, [(*vertices, "position")], indices)

    def draw_inked(self, vertices: _Vertices, indices: Any, inks: Any, *, measured: bool) -> None:  # noqa: ANN401
        """Draw as :meth:`draw` does, where ``inks`` is a buffer with the ink of each vertex."""
        layout = [(*vertices, "position"), (inks, "4f1", "ink")]
        self._render(self._program(measured=measured, inked=True), layout, indices)

    def _program(self, *, measured: bool, inked: bool) -> Program:
        if inked not in self._made:
            flags = (LINES, "INKED") if inked else (LINES,)
            self._made[inked] = self._programs.make(_VERTEX, _FRAGMENT, flags=flags, measures=False)
        return self._made[inked][measured]

    def _render(self, program: Program, layout: Sequence[tuple[Any, ...]], indices: Any) -> None:  # noqa: ANN401
        array = self._programs.context.vertex_array(program.program, layout, indices)
        array.render()
        array.release()
