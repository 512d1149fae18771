"""One technique's way through a walkthrough: what it pulls, how long it took. Begin with ``session``."""
