"""Light depth maps: how they are laid out, drawn, kept, and compared with receivers."""
