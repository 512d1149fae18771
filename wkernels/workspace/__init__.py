"""What every room takes from a frame: memory, products that are kept, a stopwatch, what is left out.

Begin with ``workspace``.
"""
