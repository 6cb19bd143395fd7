"""How long an image may be shown while the viewer and the objects move: pure functions of boxes and viewpoints, no OpenGL.

``images`` answers "how wrong now?" and "for how far?" for quadrilaterals and for depth meshes, ``layers`` for images of many
boxes, and ``movement`` says for how many frames. All rest on ``ray_pairs``, the angle between two points of one capture
ray, and on ``box_rays``, where the rays of a box lie. ``texel_angles`` says when texels show, and ``papers`` has the formulas
as the papers print them.
"""
