"""What frames remember of earlier ones, in folders by what is kept. Begin with ``reprojection``."""
