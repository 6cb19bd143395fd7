"""Plans drawn with OpenGL: the only package that imports moderngl. It decides nothing.

``renderer`` draws a plan and returns a ``drawn_picture``; each of the ``kinds`` of draw is a module of its own. They share
the context (``opengl``), ``programs`` and ``targets``; ``fade`` mixes two pictures. ``backdrop`` is the ground beyond the
ground, ``thread_turns`` says how often threads take turns while OpenGL draws.
"""
