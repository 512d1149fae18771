"""One technique's way through a walkthrough: what it pulls, how long it took, what it leaves behind.

Begin with ``session``; ``result`` is what a frame leaves behind.
"""

from wkernels.frame.session import Session

__all__ = ["Session"]
