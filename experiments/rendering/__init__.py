"""Techniques and references rendered frame by frame.

Begin with ``engine``: what a run asks of a renderer, and the renderer; ``reference`` traces and caches.
"""
