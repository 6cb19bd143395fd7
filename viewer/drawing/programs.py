"""OpenGL programs: what every shader of the viewer begins with, and what it is told about the view.

A kind of draw (``viewer.drawing.kinds``) brings its own vertex and fragment shader as GLSL 3.30 text without a head. The head
declares the view (``eye_from_world``, ``eye``, ``projection``, ``clip``), ``project`` and the outputs, and defines flags:

    MEASURED    the program also puts out, per pixel, the object, its depth along the axis, and by what angle an impostor's
                surface is displaced (-1 where geometry, ground or sky shows); images that stay on the GPU are captured with it
    COVERAGE    for multisampling: silhouettes of layers become coverage of samples
    LINES       edges of meshes are drawn (``viewer.drawing.kinds.lines``), for which the head has ``project_line``
    TINTED      the picture is mixed with an ink (``viewer.drawing.style``), for which the head has ``tinted``; programs that
                draw with an ink and without are :class:`InkedProgram`, which have it as their uniform ``ink``

Programs may be made at any time, between draws as well: what is looked through counts for them too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from mmi.foundation.camera import View
from viewer.drawing.style import Ink

__all__ = [
    "FAR",
    "MODES",
    "NEAR",
    "SCREEN_VERTEX",
    "InkedArrays",
    "InkedProgram",
    "Program",
    "Programs",
    "ink_bytes",
]

MODES = (False, True)
"""Kinds of pictures: those that are not measured, and those that are."""
NEAR, FAR = 0.1, 20_000.0
"""Metres along the axis between which things are drawn."""
_SAMPLE_ALPHA_TO_COVERAGE = 0x809E
_TEXTURE_UNITS = ("picture", "depths", "ids", "parts", "panes")
"""Names of samplers. The place of a name in this list is its texture unit."""
_COMMON = """
uniform mat3 eye_from_world;
uniform vec3 eye;
uniform vec4 projection;  // x and y scale, x and y offset
uniform vec2 clip;        // near, far
vec4 project(vec3 p) {    // p in the eye's frame
    return vec4(projection.x * p.x - projection.z * p.z, projection.y * p.y - projection.w * p.z,
                (clip.y + clip.x) / (clip.x - clip.y) * p.z + 2.0 * clip.x * clip.y / (clip.x - clip.y), -p.z);
}
"""
_LINES = """
vec4 project_line(vec3 p) {  // as far away as a share less of what it is
    vec4 found = project(p);
    found.z += 2.0 * clip.x * clip.y / (clip.x - clip.y) * (1.0 / 0.99 - 1.0);
    return found;
}
"""
_TINT = """
vec3 tinted(vec3 color, vec4 ink) {  // the ink's fourth number is its pattern, by 255
    vec2 at = gl_FragCoord.xy;
    int pattern = int(ink.a * 255.0 + 0.5);
    float across = step(mod(at.x + at.y, 12.0), 2.0), back = step(mod(at.x - at.y, 12.0), 2.0);
    float dots = step(length(mod(at, 9.0) - 4.5), 1.8);
    float mark = pattern == 1 ? across : pattern == 2 ? dots : pattern == 3 ? max(across, back) : 0.0;
    float light = dot(ink.rgb, vec3(0.299, 0.587, 0.114));
    return mix(color, mix(ink.rgb, vec3(light > 0.45 ? 0.0 : 1.0), 0.5 * mark), 0.6);
}
"""
_OUTPUTS = """
layout(location = 0) out vec4 color_out;
#ifdef MEASURED
layout(location = 1) out int id_out;
layout(location = 2) out vec2 surface_out;  // depth along the axis, displacement as an angle
#endif
"""
SCREEN_VERTEX = """
out vec2 at;
void main() {
    at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
    gl_Position = vec4(at, 0.9999999, 1.0);
}
"""
"""One triangle over the whole picture, behind everything; ``at`` goes from -1 to 1 over it."""


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A program and those of its uniforms that the compiler has kept."""

    program: Any
    uniforms: Mapping[str, Any]

    def set(self, values: Mapping[str, bytes]) -> None:
        """Set uniforms; what the program does not use is passed over."""
        for name, value in values.items():
            if name in self.uniforms:
                self.uniforms[name].write(value)


class Programs:
    """All programs of one OpenGL context, for pictures that are measured (true) and for those that are not.

    ``samples`` is the multisampling of unmeasured pictures.
    """

    def __init__(self, context: Any, *, samples: int) -> None:  # noqa: ANN401
        self.context, self.samples = context, samples
        self._made: dict[bool, list[Program]] = {mode: [] for mode in MODES}
        self._told: dict[bool, Mapping[str, bytes]] = {mode: {} for mode in MODES}

    def make(
        self, vertex: str, fragment: str, *, flags: Sequence[str] = (), measures: bool = True
    ) -> Mapping[bool, Program]:
        """A program for each of ``MODES``; one that does not measure puts out colour only, whatever the picture."""
        made = {}
        for mode in MODES:
            defined = [
                *(["MEASURED"] if mode and measures else []),
                *(["COVERAGE"] if self.smooth(mode) else []),
                *flags,
            ]
            head = "\n".join(["#version 330", *(f"#define {flag}" for flag in defined)]) + _COMMON
            head += _LINES if "LINES" in defined else ""
            tools = (_TINT if "TINTED" in defined else "") + _OUTPUTS
            program = self.context.program(vertex_shader=head + vertex, fragment_shader=head + tools + fragment)
            uniforms = {name: program[name] for name in program if isinstance(program[name], moderngl.Uniform)}
            for unit, name in enumerate(_TEXTURE_UNITS):
                if name in uniforms:
                    uniforms[name].value = unit
            made[mode] = Program(program, uniforms)
            made[mode].set(self._told[mode])
            self._made[mode].append(made[mode])
        return made

    def smooth(self, measured: bool) -> bool:
        """Whether such pictures are multisampled."""
        return self.samples > 0 and not measured

    @contextmanager
    def covering(self, *, measured: bool) -> Iterator[None]:
        """Within it, the alpha of what is drawn into multisampled pictures becomes coverage of their samples."""
        if self.smooth(measured):
            self.context.enable_direct(_SAMPLE_ALPHA_TO_COVERAGE)
        yield
        if self.smooth(measured):
            self.context.disable_direct(_SAMPLE_ALPHA_TO_COVERAGE)

    def look_through(self, view: View, *, measured: bool, downwards: bool = False) -> None:
        """Tell all programs for such pictures what the next draws are seen through.

        ``downwards`` puts the top row first, as pictures that are sampled later are kept.
        """
        left, top, width, height = view.window
        f = view.focal
        up = -1.0 if downwards else 1.0
        projection = (
            2.0 * f / width,
            up * 2.0 * f / height,
            -(2.0 * left / width + 1.0),
            up * (2.0 * top / height + 1.0),
        )
        values = {
            "eye_from_world": np.ascontiguousarray(view.eye_from_world[:3, :3].T, dtype="f4").tobytes(),
            "eye": view.eye.astype("f4").tobytes(),
            "projection": np.array(projection, dtype="f4").tobytes(),
            "clip": np.array([NEAR, FAR], dtype="f4").tobytes(),
        }
        self._told[measured] = values
        for program in self._made[measured]:
            program.set(values)


class InkedProgram:
    """A program that draws with an ink (``TINTED``) and without, compiled when first needed so."""

    def __init__(self, programs: Programs, vertex: str, fragment: str) -> None:
        self.context = programs.context
        self._programs, self._shaders = programs, (vertex, fragment)
        self._made: dict[bool, Mapping[bool, Program]] = {}

    def ready(self, ink: Ink | None, *, measured: bool) -> Program:
        """The program for pictures that are measured or not, which has been told its ink."""
        tinted = ink is not None
        if tinted not in self._made:
            self._made[tinted] = self._programs.make(*self._shaders, flags=("TINTED",) if tinted else ())
        if ink is not None:
            self._made[tinted][measured].set({"ink": ink_bytes(ink)})
        return self._made[tinted][measured]


class InkedArrays:
    """Vertex arrays for all that an :class:`InkedProgram` may be, of the same buffers.

    ``layout`` has a buffer, its format and the attributes in it, for each buffer; one is passed over where the compiled
    program uses none of its attributes.
    """

    def __init__(self, program: InkedProgram, layout: Sequence[tuple[Any, ...]]) -> None:
        self._program, self._layout = program, layout
        self._arrays: dict[tuple[bool, bool], Any] = {}

    def ready(self, ink: Ink | None, *, measured: bool, told: Mapping[str, bytes] | None = None) -> Any:  # noqa: ANN401
        """The vertex array of the program for such pictures, which has been told its ink and the uniforms ``told``."""
        program = self._program.ready(ink, measured=measured)
        program.set(told or {})
        which = ink is not None, measured
        if which not in self._arrays:
            made = program.program
            used = [(buffer, *rest) for buffer, *rest in self._layout if any(name in made for name in rest[1:])]
            self._arrays[which] = self._program.context.vertex_array(made, used)
        return self._arrays[which]

    def release(self) -> None:
        """Free the arrays; buffers are those of who made them."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()


def ink_bytes(ink: Ink) -> bytes:
    """An ink as a uniform of four numbers from 0 to 1."""
    return (np.array(ink) / 255.0).astype("<f4").tobytes()
