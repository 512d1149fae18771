"""What is measured of a picture and of a sequence of them. Begin with ``registry``."""
