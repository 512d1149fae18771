"""What a light depth map is, how it is stored, drawn and read.

Begin with ``light_map``, what kernels ask of it, and ``host_map``, what the host knows of it. ``layered`` holds several
depths a texel, ``many_maps`` the maps of many points of a light.
"""
