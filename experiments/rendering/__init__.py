"""Techniques and references rendered frame by frame. Begin with ``engine``."""
