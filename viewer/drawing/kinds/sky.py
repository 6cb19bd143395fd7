"""The sky's gradient, wherever nothing was drawn before."""

from __future__ import annotations

import moderngl
import numpy as np

from mmi.appearance.ground_mesh import SKY_HORIZON, SKY_ZENITH
from viewer.drawing.programs import SCREEN_VERTEX, Programs

__all__ = ["SkyDrawer"]

_FRAGMENT = """
uniform vec3 horizon; uniform vec3 zenith;
in vec2 at;
void main() {
    vec3 ray = vec3((at - projection.zw) / projection.xy, -1.0);
    float up = pow(clamp(normalize(ray * eye_from_world).z, 0.0, 1.0), 0.6);
    color_out = vec4(mix(horizon, zenith, up), 1.0);
#ifdef MEASURED
    id_out = -1; surface_out = vec2(1e30, -1.0);
#endif
}
"""


class SkyDrawer:
    """Draws :class:`viewer.plan.Sky`."""

    def __init__(self, programs: Programs) -> None:
        self._arrays = {}
        for mode, program in programs.make(SCREEN_VERTEX, _FRAGMENT).items():
            for name, color in (("horizon", SKY_HORIZON), ("zenith", SKY_ZENITH)):
                program.set({name: (np.array(color) / 255.0).astype("f4").tobytes()})
            self._arrays[mode] = programs.context.vertex_array(program.program, [])

    def draw(self, *, measured: bool) -> list[int]:
        """Draw one triangle over the whole picture."""
        self._arrays[measured].render(moderngl.TRIANGLES, vertices=3)
        return [1]
