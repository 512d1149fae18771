"""All samples of a light seen from a receiver by the silhouette edges before it, and a ray or three.

Begin with ``tracing``; ``light_plane`` says where edges are projected, ``clusters`` which of them a receiver needs.
"""
