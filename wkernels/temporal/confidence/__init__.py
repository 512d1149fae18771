"""Hard shadows remembered per pixel, weighted by how much each test is worth. Begin with ``blending``."""
