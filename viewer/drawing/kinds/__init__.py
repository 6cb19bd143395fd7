"""The kinds of draw, a module each: its shaders, what it keeps on the GPU, and how it is drawn.

``sky``, ``ground`` and ``objects`` (both draw ``meshes``), ``layers``. All have a method ``draw`` that sends a draw to OpenGL
and returns the triangles of each call; ``viewer.drawing.renderer`` chooses among them. A new kind is a new module here, a
member of ``viewer.plan.Draw`` and a case in the renderer.
"""
