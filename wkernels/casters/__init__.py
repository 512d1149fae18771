"""Casters as shapes: flattened onto a plane, as blobs, as edges. Begin with ``flattening``."""
