"""Light maps that are kept from frame to frame, and what a receiver learns from all of them. Begin with ``pool``."""
