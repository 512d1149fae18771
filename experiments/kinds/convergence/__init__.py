"""``kind: convergence``: error over the frames of a still camera or a path, or over light samples.

``run`` renders and measures step by step; ``estimates`` is the small form, from shadow tests that are written down.
"""
