"""``wkernels bench``: our passes beside the same passes of other renderers, in one process, in turn.

- ``rows``: what a row of the result says, and how two sides are timed;
- ``plan``: how large the cases are; ``meshes``: the spheres on a terrain that some of them draw;
- ``cases``: all cases by name, and what they should reach;
- ``passes``, ``references``, ``frames``, ``scaling``, ``memory``, ``startup``: what is timed;
- ``llvmpipe``: a peer, Mesa's software OpenGL; ``shaders``: its GLSL; ``ray_peers``: Mitsuba and embreex;
- ``machine``: what the numbers were measured with; ``plots``: the scaling cases as pictures.
"""
