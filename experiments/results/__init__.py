"""Result folders: what is written into them, read back and compared. Begin with ``store``."""
