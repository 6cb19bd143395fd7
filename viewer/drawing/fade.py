"""The mixture of two pictures, for cross-fades: what is drawn now over what was drawn before."""

from __future__ import annotations

import moderngl
import numpy as np

from viewer.drawing.programs import SCREEN_VERTEX, Programs
from viewer.drawing.targets import Targets

__all__ = ["Fade"]

_FRAGMENT = """
uniform sampler2D picture;
uniform float share;
in vec2 at;
void main() { color_out = vec4(texture(picture, 0.5 * at + 0.5).rgb, share); }
"""


class Fade:
    """Keeps a picture, and mixes it into a later one."""

    def __init__(self, programs: Programs) -> None:
        self._context = programs.context
        self._programs = programs.make(SCREEN_VERTEX, _FRAGMENT, measures=False)
        self._arrays = {
            mode: programs.context.vertex_array(program.program, []) for mode, program in self._programs.items()
        }

    def keep(self, targets: Targets, *, measured: bool) -> None:
        """Keep the colours of the picture that is there now."""
        targets.resolve(measured=measured)

    def mix(self, targets: Targets, share: float, *, measured: bool) -> list[int]:
        """Mix the kept picture into the one that is there now: ``share`` of the kept one. Ids and depths stay."""
        targets.use_color(measured=measured)
        self._context.disable(moderngl.DEPTH_TEST)
        self._context.enable(moderngl.BLEND)
        self._context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        targets.resolved.use(0)
        self._programs[measured].set({"share": np.float32(share).tobytes()})
        self._arrays[measured].render(moderngl.TRIANGLES, vertices=3)
        self._context.disable(moderngl.BLEND)
        return [1]
