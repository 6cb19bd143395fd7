"""The kinds of draw. Each has a module with its shaders, what it keeps on the GPU, and how it is drawn.

They are ``sky``, ``ground`` and ``objects`` (which both draw ``meshes``), ``layers``, and ``reliefs`` of captured images. All
have a method ``draw`` that sends a draw to OpenGL and returns the triangles of each call; ``viewer.drawing.renderer`` chooses
among them. A new kind is a new module here, a member of ``viewer.plan.Draw`` and a case in the renderer.
"""
