"""Plans drawn with OpenGL: the only package that imports moderngl. It decides nothing.

``renderer`` draws a plan and returns a ``drawn_picture``; ``buffers``, ``shaders`` and ``backdrop`` are what it
uses; ``thread_turns`` says how often threads take turns while it does.
"""
