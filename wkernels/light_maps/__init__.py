"""What a light depth map is, how it is stored, drawn and read. Begin with ``light_map``."""
