"""How a kernel is run: in tiles over CPU threads or plainly on CUDA, pixel by pixel or in lanes.

Begin with ``launch``; ``lanes`` is the vocabulary of kernels that handle 16 pixels at once.
"""
