"""Memory from frame to frame: history, shadow buffers, sums of light samples, and their smoothing in the eye's view."""
