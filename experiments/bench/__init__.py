"""``wkernels bench``: our passes beside the same passes of other renderers, in one process, in turn.

- ``rows``: what a row of the result says, and how two sides are timed;
- ``meshes``: the spheres on a terrain that the cases draw;
- ``cases``: what is timed;
- ``llvmpipe``: the peer, Mesa's software OpenGL; ``shaders``: its GLSL.
"""
