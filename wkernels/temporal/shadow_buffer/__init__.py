"""Shadow tests of earlier frames, kept per pixel (the shadow buffer). Begin with ``record``, ``rules`` and ``step``."""
