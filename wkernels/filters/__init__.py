"""Filters over light maps and images: comparisons, moments, sums, neighbours. Begin with ``penumbra``."""
