"""Where a light looks: views fitted to what is seen, split, warped or stabilised. Begin with ``light_views``."""
